"use strict";
// What both kinds of the page have: the figure, its view and the keys.

const SHOW_EVERY = 0.25; // seconds between two values of the facts
const find = (selector) => document.querySelector(selector);
const press = (button, isOn) => button.setAttribute("aria-pressed", String(isOn));

// Those that extend it say with `number` which frame is shown, null for the rest pose.
class LivePage {
  constructor(content) {
    this.content = content;
    if (content.figure) this.setFigure(content.figure);
    find("#home").addEventListener("click", () => this.stage?.resetView());
    find("#theme").addEventListener("click", () => this.stage?.turnTheme());
    find("#bones").addEventListener("click", () => {
      if (!this.stage) return; // it comes with the first frame
      this.stage.setLook({ hasSticks: !this.stage.hasSticks });
      press(find("#bones"), this.stage.hasSticks);
    });
    document.addEventListener("keydown", (event) => this.onKey(event));
    requestAnimationFrame((now) => this.tick(now));
  }

  setFigure(figure) {
    this.motion = new ArrivingMotion(figure);
    this.stage = new Stage(find("#stage"), [this.motion]);
  }

  get keys() {
    return {
      a: () => this.stage?.rotate(-0.15, 0), d: () => this.stage?.rotate(0.15, 0),
      w: () => this.stage?.rotate(0, 0.1), s: () => this.stage?.rotate(0, -0.1),
      r: "#home", t: "#theme", b: "#bones", m: "#mute", x: "#rest", i: "#interrupt", l: "#other",
      o: "#file", k: "#microphone", Escape: "#stop",
    };
  }

  onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("select, input:not([type=range])") && event.key !== "Escape") return;
    const action = this.keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    if (typeof action === "function") action();
    else if (find(action)?.offsetParent) find(action).click();
  }

  say(text, isTrouble = false) {
    find("#status").textContent = text;
    find("#status").classList.toggle("trouble", isTrouble);
  }

  tick(now) {
    requestAnimationFrame((now) => this.tick(now));
    if (!this.stage) return;
    const number = this.number, isMoving = number !== null || this.motion.isEasing;
    if (!isMoving && !this.wasMoving && !this.stage.isStale) return;
    if (isMoving) this.stage.keepPace(now);
    this.wasMoving = isMoving;
    this.stage.draw(number, true);
    this.drawn(now / 1000, number);
  }

  drawn() {}
}

function clockText(seconds) {
  return `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;
}
