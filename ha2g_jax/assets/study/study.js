// The study: consent, the parts with their instructions, comments, and the end.

import { element, show } from "./elements.js";
import { commentPage, consentPage, instructionPage } from "./pages.js";
import { fetchClip } from "./player.js";
import { QuestionPlugin } from "./questions.js";
import { finish } from "./sending.js";
import { Session, Storage, identify } from "./session.js";

const display = document.querySelector("#study");

async function read() {
  const response = await fetch("items.json");
  if (!response.ok) throw new Error("The study could not be loaded. Please reload the page later.");
  return response.json();
}

// The timeline of jsPsych; what is already answered is left out.
function timeline(session) {
  const { content, order, sides } = session, pages = session.state.consent ? [] : [consentPage(session)];
  const introduced = new Set();
  const remaining = session.remaining;
  remaining.forEach((item, index) => {
    if (item.kind !== "attention" && !introduced.has(item.kind)) {
      introduced.add(item.kind);
      pages.push(instructionPage(item.kind, content));
    }
    const names = sides.get(item.id) ?? [item.stimulus], next = remaining[index + 1];
    pages.push({
      type: QuestionPlugin, item, names, content, number: order.indexOf(item) + 1,
      on_start: () => progress(order.indexOf(item), order.length),
      on_load: () => { if (next) preload(sides.get(next.id) ?? [next.stimulus]); }, // while this one is answered
      on_finish: ({ answer }) => session.record(answer),
    });
  });
  if (!session.state.finished) pages.push({ ...commentPage(session), on_start: () => progress(order.length, order.length) });
  return pages;
}

function progress(done, all) {
  const line = document.querySelector("#progress");
  line.hidden = false;
  line.querySelector("label").textContent = done < all ? `Question ${done + 1} of ${all}` : "All questions answered";
  line.querySelector("progress").value = done / all;
}

function preload(names) {
  for (const name of names) fetchClip(name).catch(() => {}); // its own page says what is wrong
}

async function main() {
  const content = await read(), storage = new Storage();
  const jsPsych = jsPsychModule.initJsPsych({ display_element: display, use_webaudio: false });
  const session = new Session(content, identify(content.study, storage), storage, jsPsych.randomization);
  window.study = session; // for the owner's own tests
  const pages = timeline(session), [first] = session.remaining;
  if (first) preload(session.sides.get(first.id) ?? [first.stimulus]);
  if (pages.length) {
    const running = jsPsych.run(pages);
    display.removeAttribute("tabindex");
    await running;
  }
  await finish(display, session);
}

main().catch((error) => show(display, "The study cannot be shown", element("p", { role: "alert" }, error.message)));
