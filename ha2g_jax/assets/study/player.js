// One video, or two that play together with one sound, always from the beginning to the end.

import { element } from "./elements.js";

const MAX_APART = 0.08; // seconds between two videos before one is moved

export class Player {
  // names: ids of the stimuli; captions: text below each, if there are two; onchange: called when something changed.
  constructor(names, captions, onchange) {
    Object.assign(this, { onchange, plays: 0, hasEnded: false, isPlaying: false });
    this.videos = names.map((name, index) => element("video", {
      src: `media/${name}.mp4`, preload: "auto", playsinline: true, tabindex: -1,
      "aria-label": captions[index] ? `Clip on the ${captions[index].toLowerCase()}` : "Clip",
    }));
    this.videos.slice(1).forEach((video) => { video.muted = true; }); // the sound of both is the same
    this.alert = element("p", { role: "alert", class: "alert" });
    this.button = element("button", { type: "button", class: "play", onclick: () => this.toggle() }, "Play");
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
  }

  async toggle() {
    if (this.isPlaying) {
      this.videos.forEach((video) => video.pause());
      return this.set(false);
    }
    if (this.videos.some((video) => video.error)) this.videos.forEach((video) => video.load());
    if (this.videos.every((video) => video.ended || video.currentTime === 0)) {
      this.videos.forEach((video) => { video.currentTime = 0; });
      this.plays += 1;
    }
    this.alert.textContent = "";
    this.set(true);
    try {
      await Promise.all(this.videos.map((video) => (video.ended ? null : video.play())));
    } catch (error) {
      if (error.name !== "AbortError") this.fail(); // it is aborted by a pause or by the next page
    }
  }

  align() {
    const [first, ...others] = this.videos;
    for (const other of others) {
      if (this.isPlaying && !first.ended && !other.ended && Math.abs(other.currentTime - first.currentTime) > MAX_APART) {
        other.currentTime = first.currentTime;
      }
    }
  }

  end() {
    if (!this.videos.every((video) => video.ended)) return;
    this.hasEnded = true;
    this.set(false);
  }

  fail() {
    this.videos.forEach((video) => video.pause());
    this.set(false);
    this.alert.textContent = "The clip could not be played. Please check your connection and press Play again.";
  }

  set(isPlaying) {
    this.isPlaying = isPlaying;
    this.button.textContent = isPlaying ? "Pause" : this.hasEnded ? "Play again" : "Play";
    this.onchange();
  }
}
