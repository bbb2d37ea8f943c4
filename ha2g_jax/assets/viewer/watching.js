"use strict";
// The page for frames that a server sends, each at its time: it shows them a little later, at an even pace.

const PACE_BUFFER = 0.1; // seconds
const FOLLOW = 0.02; // of a difference, in each frame

class WatchingPage extends LivePage {
  constructor(content) {
    super(content);
    this.offset = null;
    this.say("Waiting for ha2g live ...");
    new Broadcast({
      onfigure: (figure) => {
        if (this.described && this.described !== JSON.stringify(figure)) location.reload();
        if (!this.described) this.setFigure(figure);
        this.described = JSON.stringify(figure);
      },
      onframes: (first, rows) => this.take(first, rows),
      onstate: (isOpen) => {
        this.offset = null;
        this.motion?.clear();
        this.say(isOpen ? "Connected: waiting for sound ..." : "Waiting for ha2g live ...");
      },
    });
  }

  // The offset is the earliest time at which frame 0 would have come; it follows slowly where frames come later.
  take(first, rows) {
    const offset = performance.now() / 1000 - first / this.motion.fps;
    if (this.offset === null) {
      this.offset = offset;
      this.say("");
    }
    this.offset = offset < this.offset ? offset : this.offset + FOLLOW * (offset - this.offset);
    this.motion.add(first, rows);
  }

  get number() {
    if (this.offset === null || !this.motion) return null;
    return (performance.now() / 1000 - this.offset - PACE_BUFFER) * this.motion.fps;
  }

  drawn(now) {
    if (this.motion.shown === null || now < (this.next || 0)) return;
    this.next = now + SHOW_EVERY;
    const { shown, fps } = this.motion;
    find("#facts").textContent = `${clockText(shown / fps)} · frame ${Math.floor(shown)}`;
  }
}

async function start() {
  await loadThree();
  const content = JSON.parse(find("#content").textContent);
  window.live = new (content.source === "sound" ? SpeakingPage : WatchingPage)(content);
}

start().catch((error) => {
  find("#status").textContent = `The figure cannot be drawn here: ${error.message || error}. ` +
    "A browser of 2023 or later with WebGL is needed.";
});
