/** The panel below the figure: time, facts, and the buttons that fit what goes on. */

import { find, show } from "./elements.js";
import type { LiveRun } from "./live.js";
import { PEAK_RATE } from "./peaks.js";
import { RATE, type Sound } from "./sound.js";

export class Panel {
  private timeline: Timeline | null = null;
  private duration = 0;

  /** @param seek - is called with the time in seconds that the visitor chooses. */
  constructor(private readonly seek: (time: number) => void) {}

  /** Shows other sound. */
  present(sound: Sound): void {
    this.duration = sound.samples.length / RATE;
    find<HTMLInputElement>("#scrub").max = String(this.duration);
    const canvas = find<HTMLCanvasElement>("#timeline");
    const fresh = canvas.cloneNode() as HTMLCanvasElement; // without the listeners of the timeline before
    canvas.replaceWith(fresh);
    const content = { duration: this.duration, words: [], peakRate: PEAK_RATE };
    this.timeline = new Timeline(fresh, content, sound.peaks, (time) => this.seek(time));
  }

  showTime(time: number): void {
    this.timeline?.draw(time);
    find("#time").textContent = `${clockText(time)} / ${clockText(this.duration)}`;
    const scrub = find<HTMLInputElement>("#scrub");
    scrub.value = String(time);
    scrub.setAttribute("aria-valuetext", clockText(time));
  }

  showPlaying(isPlaying: boolean): void {
    find("#play").dataset.state = isPlaying ? "playing" : "paused";
    find("#play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
  }

  /** Shows the delay and the level of a live run. */
  showRun({ stream, delay, late, level, recording }: LiveRun): void {
    find<HTMLMeterElement>("#level").value = level;
    const buffer = Math.round(1000 * (delay - stream.latency));
    const facts = [`latency ${Math.round(1000 * stream.latency)} + ${buffer} ms`];
    if (late) facts.push(`${late} late`);
    if (recording) facts.push(`${clockText(recording.seconds, 0)} recorded`);
    find("#facts").textContent = facts.join(" · ");
  }

  /**
   * Shows the buttons that fit.
   *
   * @param isBusy - whether something goes on that Stop ends.
   * @param isLive - whether the microphone is followed.
   * @param hasTake - whether there is a motion with its sound.
   */
  showState(isBusy: boolean, isLive: boolean, hasTake: boolean): void {
    const wasFocused = document.activeElement?.matches(".main");
    show(!isBusy, "#file", "#microphone", "#example");
    show(isBusy, "#stop");
    show(isLive, "#level", "#record", "#rest", "#acting");
    show(hasTake && !isLive, "#track", "#time", "#mute");
    show(hasTake && !isBusy, "#play", "#save");
    find("#file").classList.toggle("quiet", hasTake);
    find<HTMLInputElement>("#ahead").disabled = isLive;
    if (!isLive) find("#facts").textContent = "";
    if (wasFocused && document.activeElement?.matches("body, [hidden]")) find(isBusy ? "#stop" : "#file").focus();
  }
}
