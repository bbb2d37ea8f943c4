// The last page: answers are sent, or saved as a file.

import { element, show } from "./elements.js";
import { paragraphs } from "./pages.js";

const PATIENCE = 30000; // milliseconds

async function post(address, text) {
  const response = await fetch(address, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: text,
    credentials: "omit", referrerPolicy: "no-referrer", signal: AbortSignal.timeout(PATIENCE),
  });
  if (!response.ok) throw new Error(`status ${response.status}`);
}

function download(name, text) {
  const address = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  const link = element("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), PATIENCE);
}

export async function finish(display, session) {
  const { content, state, participant } = session, { post: address } = content;
  const text = `${JSON.stringify(session.document(), null, 1)}\n`;
  const status = element("p", { role: "status", class: "status" });
  const closing = element("div", { class: "closing", hidden: true }, ...paragraphs(content.closing));
  const save = element("button", { type: "button", class: "save" }, "Save my answers as a file");
  const again = element("button", { type: "button", class: "again", hidden: true }, "Try again");
  const forget = element("button", { type: "button", class: "forget", hidden: true }, "Remove my answers from this browser");
  const done = (message) => {
    status.textContent = message;
    [again.hidden, closing.hidden, forget.hidden] = [true, false, false];
  };
  save.addEventListener("click", () => {
    download(`${content.study}-${participant}.json`, text);
    done("Your answers are in a file among your downloads. Please give this file to the person who invited you.");
  });
  forget.addEventListener("click", () => {
    session.forget();
    [save.hidden, forget.hidden] = [true, true];
    status.textContent = "Your answers are removed from this browser. You may close the page.";
  });
  const send = async () => {
    again.hidden = true;
    status.textContent = "Sending your answers …";
    try {
      await post(address, text);
    } catch (error) {
      again.hidden = save.hidden = false;
      const reason = error instanceof Error ? error.message : String(error);
      status.textContent = `Your answers could not be sent (${reason}). They are kept in this browser. Please try again, or save them as a file and give it to the person who invited you.`;
      return;
    }
    session.change({ isSent: true });
    save.hidden = false;
    done("Your answers are sent.");
  };
  again.addEventListener("click", send);
  show(display, "The end", status, closing, element("div", { class: "actions" }, save, again, forget));
  if (!address) status.textContent = "All questions are answered. Please save your answers as a file now.";
  else if (state.isSent) done("Your answers are sent.");
  else {
    save.hidden = true;
    await send();
  }
}
