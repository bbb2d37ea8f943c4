// One video, or two that play together with one sound, always from the beginning to the end.

import { element } from "./elements.js";

const FAR = 0.25, NEAR = 0.03; // seconds between two videos: one is moved, or plays a little faster or slower
const FASTER = 1.1;

// Videos are fetched whole before they play, so that no connection can hold up one of two.
const clips = new Map(); // id of a stimulus -> promise of an address

export function fetchClip(name) {
  if (!clips.has(name)) {
    const clip = fetch(`media/${name}.mp4`).then(async (response) => {
      if (!response.ok) throw new Error(`status ${response.status}`);
      return URL.createObjectURL(await response.blob());
    });
    clip.catch(() => clips.delete(name)); // so that it is fetched again
    clips.set(name, clip);
  }
  return clips.get(name);
}

export class Player {
  // names: ids of the stimuli; captions: text above each, if there are two; onchange: called when something changed.
  constructor(names, captions, onchange) {
    Object.assign(this, { names, onchange, plays: 0, hasEnded: false, isPlaying: false, isReady: false });
    this.videos = names.map((_, index) => element("video", {
      playsinline: true, tabindex: -1,
      "aria-label": captions[index] ? `Clip on the ${captions[index].toLowerCase()}` : "Clip",
    }));
    this.videos.slice(1).forEach((video) => { video.muted = true; }); // the sound of both is the same
    this.alert = element("p", { role: "alert", class: "alert" });
    this.button = element("button", { type: "button", class: "play", onclick: () => this.toggle() });
    const figures = this.videos.map((video, index) => {
      const caption = captions[index] ? [element("figcaption", {}, captions[index])] : [];
      return element("figure", {}, ...caption, video);
    });
    this.element = element("div", { class: "player" },
      element("div", { class: `videos of-${names.length}` }, ...figures), this.button, this.alert);
    for (const video of this.videos) {
      video.addEventListener("ended", () => this.end());
      video.addEventListener("error", () => this.fail());
      video.addEventListener("click", () => this.toggle());
    }
    this.videos[0].addEventListener("timeupdate", () => this.align());
    this.load();
  }

  async load() {
    this.button.textContent = "Loading …";
    try {
      const addresses = await Promise.all(this.names.map(fetchClip));
      this.videos.forEach((video, index) => { video.src = addresses[index]; });
      this.isReady = true;
    } catch {
      return this.fail();
    }
    this.set(false);
  }

  async toggle() {
    if (this.isPlaying) {
      this.videos.forEach((video) => video.pause());
      return this.set(false);
    }
    if (!this.isReady) {
      this.alert.textContent = "";
      await this.load();
    }
    if (!this.isReady || this.isPlaying) return;
    if (this.videos.every((video) => video.ended || video.currentTime === 0)) {
      this.videos.forEach((video) => { video.currentTime = 0; });
      this.plays += 1;
    }
    this.set(true);
    try {
      await Promise.all(this.videos.map((video) => (video.ended ? null : video.play())));
    } catch (error) {
      if (error.name !== "AbortError") this.fail(); // it is aborted by a pause or by the next page
    }
  }

  // Lets the second video, which is not heard, catch up with the first or wait for it.
  align() {
    const [first, second] = this.videos;
    if (!second || !this.isPlaying || first.ended || second.ended || second.seeking) return;
    const apart = first.currentTime - second.currentTime;
    if (Math.abs(apart) > FAR) second.currentTime = first.currentTime;
    second.playbackRate = Math.abs(apart) < NEAR ? 1 : apart > 0 ? FASTER : 1 / FASTER;
  }

  end() {
    if (!this.videos.every((video) => video.ended)) return;
    this.hasEnded = true;
    this.set(false);
  }

  fail() {
    this.videos.forEach((video) => video.pause());
    this.forget();
    this.isReady = false;
    this.set(false);
    this.alert.textContent = "The clip could not be played. Please check your connection and press Play once more.";
  }

  set(isPlaying) {
    this.isPlaying = isPlaying;
    this.button.textContent = isPlaying ? "Pause" : this.hasEnded ? "Play again" : "Play";
    this.onchange();
  }

  forget() { this.names.forEach((name) => clips.delete(name)); }

  // Stops the videos and gives their memory back.
  async dispose() {
    this.videos.forEach((video) => video.pause());
    const taken = this.names.flatMap((name) => clips.get(name) ?? []);
    this.forget(); // at once, because the next page may show one of them and has to fetch it again
    for (const address of await Promise.all(taken)) URL.revokeObjectURL(address);
  }
}
