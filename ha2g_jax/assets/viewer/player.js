"use strict";
// Play, pause, seek, keys. Where there is sound, its time is the time of the figures.

const SPEEDS = [0.25, 0.5, 0.75, 1, 1.5, 2];

class SoundClock {
  constructor(sound, duration) {
    this.duration = duration;
    this.audio = new Audio(URL.createObjectURL(new Blob([bytesOf(sound)], { type: "audio/mpeg" })));
    this.audio.preload = "auto";
    this.audio.preservesPitch = true;
  }
  get time() { return Math.min(this.audio.currentTime, this.duration); }
  set time(time) { this.audio.currentTime = time; }
  get isPlaying() { return !this.audio.paused && !this.audio.ended; }
  get hasEnded() { return this.audio.ended; }
  set speed(speed) { this.audio.playbackRate = speed; }
  play() { return this.audio.play(); }
  pause() { this.audio.pause(); }
}

class SilentClock {
  constructor(duration) {
    Object.assign(this, { duration, rate: 1, at: 0, since: null });
  }
  get time() {
    return this.since === null ? this.at
      : Math.min(this.at + (this.rate * (performance.now() - this.since)) / 1000, this.duration);
  }
  set time(time) { this.at = time; if (this.since !== null) this.since = performance.now(); }
  get hasEnded() { return this.since !== null && this.time >= this.duration; }
  get isPlaying() { return this.since !== null && !this.hasEnded; }
  set speed(speed) { this.time = this.time; this.rate = speed; }
  async play() { if (this.time >= this.duration) this.at = 0; this.since = performance.now(); }
  pause() { this.at = this.time; this.since = null; }
}

class Player {
  constructor(content, motions, peaks) {
    this.content = content;
    this.motions = motions;
    this.duration = content.duration;
    this.clock = content.sound ? new SoundClock(content.sound, this.duration) : new SilentClock(this.duration);
    this.find = (selector) => document.querySelector(selector);
    this.stage = new Stage(this.find("#stage"), motions, content.view);
    const curves = motions.map((motion, figure) => {
      return { fps: motion.fps, colour: this.stage.shirts[figure], speeds: this.see(motion, figure) };
    });
    const shown = motions.length > 1 ? curves : [];
    this.timeline = new Timeline(this.find("#timeline"), content, peaks, (time) => this.seek(time), shown);
    this.speed = 1;
    this.isLooping = false;
    this.isSmooth = true;
    this.bind();
    this.tick();
  }

  get time() { return this.clock.time; }

  // Fits the view to all frames of a motion, and returns the speed of both wrists in each, in metres per second.
  see(motion, figure) {
    const wrists = ["left_wrist", "right_wrist"].map((name) => 3 * motion.joints.indexOf(name));
    let before = null;
    return Array.from({ length: motion.frames }, (_, frame) => {
      const positions = motion.positionsAt(frame / motion.fps, false);
      this.stage.include(figure, positions);
      const places = wrists.map((i) => [...positions.subarray(i, i + 3)]);
      const steps = places.map((place, k) => Math.hypot(...place.map((at, axis) => at - (before || places)[k][axis])));
      before = places;
      return motion.fps * (steps[0] + steps[1]);
    });
  }

  async play() {
    if (this.time >= this.duration) this.clock.time = 0;
    await this.clock.play();
    this.stage.isStale = true;
  }

  pause() { this.clock.pause(); this.stage.isStale = true; }

  toggle() { return this.clock.isPlaying ? this.pause() : this.play(); }

  seek(time) {
    this.clock.time = Math.min(Math.max(time, 0), this.duration);
    this.stage.isStale = true;
  }

  // Seek to a frame of the first motion, plus a tiny offset so that rounding does not show the frame before.
  step(frames) {
    this.pause();
    const [{ fps }] = this.motions;
    this.seek((Math.floor(this.time * fps + 1e-4) + frames) / fps + 1e-4);
  }

  setSpeed(speed) {
    this.speed = this.clock.speed = speed;
    this.find("#speed").value = String(speed);
  }

  changeSpeed(by) {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  // The state that is drawn now, for scripts that control the page.
  shown() {
    return {
      time: this.drawnTime,
      figures: this.motions.map((motion, figure) => ({
        name: motion.name,
        frame: motion.frameAt(this.drawnTime),
        joints: Object.fromEntries(
          motion.joints.map((name) => [name, this.stage.bodies[figure].joint(name).toArray()]),
        ),
      })),
    };
  }

  tick(now = 0) {
    requestAnimationFrame((now) => this.tick(now));
    if (this.clock.hasEnded && this.isLooping) { this.seek(0); this.play(); }
    const time = this.time, isPlaying = this.clock.isPlaying;
    if (!isPlaying && !this.stage.isStale && time === this.drawnTime) return;
    if (isPlaying) this.stage.keepPace(now);
    this.drawnTime = time;
    this.stage.draw(time, this.isSmooth);
    this.timeline.draw(time);
    this.find("#time").textContent = `${clockText(time)} / ${clockText(this.duration)}`;
    this.find("#frame").textContent = `frame ${this.motions[0].frameAt(time)}`;
    const button = this.find("#play");
    button.dataset.state = isPlaying ? "playing" : "paused";
    button.setAttribute("aria-label", isPlaying ? "Pause" : "Play");
    const scrub = this.find("#scrub");
    scrub.value = time;
    scrub.setAttribute("aria-valuetext", clockText(time));
  }

  bind() {
    const on = (selector, action) =>
      this.find(selector).addEventListener("click", (event) => action(event.currentTarget));
    const toggled = (button, isOn) => button.setAttribute("aria-pressed", String(isOn));
    this.find("#scrub").max = this.duration;
    this.find("#scrub").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    this.find("#speed").replaceChildren(...SPEEDS.map((speed) => new Option(`${speed}×`, String(speed))));
    this.find("#speed").addEventListener("change", (event) => this.setSpeed(Number(event.target.value)));
    this.setSpeed(1);
    this.find("#overlay").hidden = this.motions.length < 2;
    this.find("#mute").hidden = !this.content.sound;
    this.find("#timeline").classList.toggle("bare", !this.content.sound && !this.content.words.length);
    on("#play", () => this.toggle());
    on("#home", () => this.stage.resetView());
    on("#overlay", (button) => {
      this.stage.setLook({ isOverlaid: !this.stage.isOverlaid });
      toggled(button, this.stage.isOverlaid);
    });
    on("#bones", (button) => {
      this.stage.setLook({ hasSticks: !this.stage.hasSticks });
      toggled(button, this.stage.hasSticks);
    });
    on("#loop", (button) => toggled(button, (this.isLooping = !this.isLooping)));
    on("#mute", (button) => toggled(button, (this.clock.audio.muted = !this.clock.audio.muted)));
    on("#theme", () => this.stage.turnTheme());
    on("#keys", () => this.find("dialog").showModal());
    document.addEventListener("keydown", (event) => this.onKey(event));
  }

  onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.find("dialog").open) return;
    if (event.target.matches("select") || (event.key === " " && event.target.matches("button"))) return;
    const press = (selector) => () => { if (!this.find(selector).hidden) this.find(selector).click(); };
    const by = event.shiftKey ? 5 : 1;
    const action = {
      " ": () => this.toggle(), k: () => this.toggle(),
      ArrowLeft: () => this.seek(this.time - by), ArrowRight: () => this.seek(this.time + by),
      ",": () => this.step(-1), ".": () => this.step(1),
      Home: () => this.seek(0), End: () => this.seek(this.duration),
      ArrowUp: () => this.changeSpeed(1), ArrowDown: () => this.changeSpeed(-1),
      a: () => this.stage.rotate(-0.15, 0), d: () => this.stage.rotate(0.15, 0),
      w: () => this.stage.rotate(0, 0.1), s: () => this.stage.rotate(0, -0.1),
      r: press("#home"), o: press("#overlay"), b: press("#bones"), l: press("#loop"), m: press("#mute"),
      t: press("#theme"), "?": press("#keys"),
      i: () => { this.isSmooth = !this.isSmooth; this.stage.isStale = true; },
      f: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
    }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

async function start() {
  await loadThree();
  const content = JSON.parse(document.querySelector("#content").textContent);
  const motions = await Promise.all(content.motions.map(
    (packed) => MotionData.unpack({ ...packed, body: content.bodies[packed.body] }, content.levels),
  ));
  window.viewer = new Player(content, motions, content.peaks ? await inflated(content.peaks) : new Uint8Array());
}

start().catch((error) => {
  const message = document.querySelector("#trouble");
  message.hidden = false;
  message.textContent = `The figure cannot be drawn here: ${error.message || error}. ` +
    "A browser of 2023 or later with WebGL is needed.";
});
