/** Buttons, keys, and files that are dropped. */

import { find, show } from "./elements.js";
import type { Page } from "./page.js";

const ARROW = 1; // seconds
const TURN = 0.15; // radians

/** Lets a page answer to its visitor. */
export function listen(page: Page): void {
  const buttons: Record<string, () => unknown> = {
    "#file": () => find("#picker").click(),
    "#microphone": () => page.listen(),
    "#example": () => page.openExample(),
    "#stop": () => page.stop(),
    "#record": () => page.record(),
    "#rest": () => page.turnRest(),
    "#play": () => page.turnPlay(),
    "#mute": () => page.turnMute(),
    "#bones": () => page.turnBones(),
    "#home": () => page.resetView(),
    "#theme": () => page.turnTheme(),
    "#wear": () => (page.hasAvatar ? page.undress() : find("#avatars").click()),
  };
  for (const [selector, action] of Object.entries(buttons)) {
    find(selector).addEventListener("click", () => void action());
  }
  for (const button of document.querySelectorAll<HTMLElement>("[data-format]")) {
    button.addEventListener("click", () => void page.saveAs(button.dataset.format as string));
  }
  const scrub = find<HTMLInputElement>("#scrub");
  scrub.addEventListener("input", () => page.seek(scrub.valueAsNumber));
  for (const selector of ["#picker", "#avatars"]) {
    const input = find<HTMLInputElement>(selector);
    input.addEventListener("change", () => {
      const [file] = input.files ?? [];
      input.value = "";
      if (file) void (selector === "#avatars" ? page.wear(file) : page.open(file));
    });
  }
  listenToDrops(page);
  document.addEventListener("keydown", (event) => press(page, event));
  const menu = find<HTMLDetailsElement>("#save");
  document.addEventListener("click", ({ target }) => {
    if (!menu.contains(target as Node)) menu.open = false;
  });
}

function listenToDrops(page: Page): void {
  let depth = 0; // of elements that the pointer has entered
  const shade = () => show(depth > 0, "#drop");
  document.addEventListener("dragenter", () => {
    depth++;
    shade();
  });
  document.addEventListener("dragleave", () => {
    depth--;
    shade();
  });
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    shade();
    const [file] = event.dataTransfer?.files ?? [];
    if (file) void page.open(file);
  });
}

function press(page: Page, event: KeyboardEvent): void {
  const target = event.target as Element;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.matches("select, input:not([type=range])") && event.key !== "Escape") return;
  if (target.matches("input:not(#scrub)") && event.key.startsWith("Arrow")) return; // they move the slider
  if (event.key === " " && target.matches("button, summary, a")) return; // it presses them
  const click = (selector: string) => () => {
    const button = document.querySelector<HTMLElement>(selector);
    if (button?.offsetParent) button.click();
  };
  const actions: Record<string, () => unknown> = {
    " ": () => page.turnPlay(),
    ArrowLeft: () => page.seek(page.time - ARROW),
    ArrowRight: () => page.seek(page.time + ARROW),
    a: () => page.rotate(-TURN, 0),
    d: () => page.rotate(TURN, 0),
    w: () => page.rotate(0, TURN),
    s: () => page.rotate(0, -TURN),
    o: click("#file"),
    k: click("#microphone"),
    e: click("#example"),
    n: click("#another"),
    c: click("#record"),
    x: click("#rest"),
    i: click("#interrupt"),
    l: click("#other"),
    v: click("#wear"),
    m: click("#mute"),
    b: click("#bones"),
    r: click("#home"),
    t: click("#theme"),
    Escape: () => escape(),
  };
  const escape = () => {
    const menu = find<HTMLDetailsElement>("#save");
    if (menu.open) {
      menu.open = false;
      find("#save summary").focus();
    } else click("#stop")();
  };
  const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  action();
}
