// Pages around the questions, as a plugin of jsPsych: consent, instructions, comments.

import { element, show } from "./elements.js";
import { ABOUT_CHECKS, ENDS, KEYS, PARTS, SCALES } from "./texts.js";

const MAX_COMMENT = 2000; // letters

export class PagePlugin {
  static info = {
    name: "ha2g-page",
    version: "1",
    parameters: {
      heading: { type: jsPsychModule.ParameterType.STRING },
      parts: { type: jsPsychModule.ParameterType.FUNCTION }, // makes the elements of the page
      missing: { type: jsPsychModule.ParameterType.FUNCTION, default: () => "" }, // says what keeps from going on
      button: { type: jsPsychModule.ParameterType.STRING },
    },
    data: {},
  };

  constructor(jsPsych) { this.jsPsych = jsPsych; }

  trial(display, { heading, parts, missing, button }) {
    const message = element("p", { role: "status", class: "status" });
    const go = () => {
      message.textContent = missing();
      if (message.textContent) return;
      document.removeEventListener("keydown", onkey);
      this.jsPsych.finishTrial();
    };
    const onkey = (event) => {
      const isText = event.target instanceof HTMLTextAreaElement || event.target instanceof HTMLButtonElement;
      if (event.key !== "Enter" || isText) return;
      event.preventDefault();
      go();
    };
    document.addEventListener("keydown", onkey);
    const next = element("button", { type: "button", class: "next", onclick: go }, button);
    show(display, heading, ...parts(), element("div", { class: "actions" }, next, message));
  }
}

export const paragraphs = (texts) => texts.map((text) => element("p", {}, text));

export function consentPage(session) {
  const box = element("input", { type: "checkbox", id: "consent" });
  const kept = session.storage.isKept ? [] : ["This browser does not store answers. Please do not reload or close the page before the end."];
  return {
    type: PagePlugin,
    heading: "Taking part",
    button: "Begin",
    parts: () => [...paragraphs([...session.content.consent, ...kept]),
      element("p", { class: "agree" }, box, element("label", { for: "consent" }, "I have read this, and I agree to take part."))],
    missing: () => (box.checked ? "" : "Please tick the box if you agree. If you do not, close this page."),
    on_finish: () => session.change({ consent: true, started: new Date().toISOString() }),
  };
}

export function instructionPage(kind, content) {
  const { title, paragraphs: texts } = PARTS[kind];
  const scales = content.scales.flatMap((name) => [element("dt", {}, SCALES[name].name),
    element("dd", {}, `${SCALES[name].question} ${SCALES[name].help}`)]);
  const keys = KEYS[kind].flatMap(([key, meaning]) => [element("dt", {}, element("kbd", {}, key)), element("dd", {}, meaning)]);
  const hasChecks = content.items.some((item) => item.kind === "attention");
  const ends = `1 means ${ENDS[0]}, 5 means ${ENDS[1]}.`;
  return {
    type: PagePlugin,
    heading: title,
    button: "Start",
    parts: () => [
      ...paragraphs(texts),
      ...(kind === "rating" ? [element("dl", { class: "scales" }, ...scales), element("p", {}, ends)] : []),
      ...(hasChecks ? paragraphs([ABOUT_CHECKS]) : []),
      element("h2", {}, "With the keyboard"),
      element("dl", { class: "keys" }, ...keys),
    ],
  };
}

export function commentPage(session) {
  const box = element("textarea", { id: "comments", rows: 8, maxlength: MAX_COMMENT });
  box.value = session.state.comments;
  box.addEventListener("input", () => session.change({ comments: box.value }));
  return {
    type: PagePlugin,
    heading: "Comments",
    button: "Finish",
    parts: () => [element("p", {}, element("label", { for: "comments" }, "Is there anything that you want to tell us? You may leave this empty.")), box],
    on_finish: () => session.change({ comments: box.value, finished: new Date().toISOString() }),
  };
}
