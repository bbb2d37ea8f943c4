/** The line that says what goes on, which readers of the screen hear, and the bar beside it. */

import { find, show } from "./elements.js";

/** Says a sentence, or nothing. */
export function say(text: string, isTrouble = false): void {
  find("#status").textContent = !text || /[.?!]$/.test(text) ? text : `${text}.`;
  find("#status").classList.toggle("trouble", isTrouble);
}

/** Shows how much is done, 0 to 1; null when there is nothing to wait for. */
export function progress(fraction: number | null): void {
  show(fraction !== null, "#progress");
  find<HTMLProgressElement>("#progress").value = fraction ?? 0;
}
