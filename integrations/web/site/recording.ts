/** Sound and frames of a part of a live run. */

import { joined } from "../src/arrays.js";
import { RATE } from "./sound.js";

const MOST_SECONDS = 600;

export class Recording {
  private readonly firstFrame: number;
  private readonly sound: Float32Array[] = [];
  private readonly motion: Float32Array[] = [];
  private numSamples = 0;
  private numValues = 0;
  /** Samples that come before the first frame of the recording. */
  private unwanted: number;

  /**
   * @param fps - frames per second.
   * @param heard - samples that came before.
   */
  constructor(
    private readonly fps: number,
    heard: number,
  ) {
    this.firstFrame = Math.ceil((heard * fps) / RATE);
    this.unwanted = Math.round((this.firstFrame * RATE) / fps) - heard;
  }

  /** Whether the recording takes no more. */
  get isFull(): boolean {
    return this.numSamples >= MOST_SECONDS * RATE;
  }

  get seconds(): number {
    return this.numSamples / RATE;
  }

  hear(samples: Float32Array): void {
    if (this.isFull) return;
    const wanted = samples.slice(Math.min(this.unwanted, samples.length));
    this.unwanted -= samples.length - wanted.length;
    this.numSamples += wanted.length;
    this.sound.push(wanted);
  }

  /**
   * Takes frames (n, bones, 3) from number `first` on; `size` is the number of values of one. Frames come later than their
   * sound, so that a full recording takes those of the sound that it has.
   */
  see(first: number, rows: Float32Array, size: number): void {
    if (this.isFull && this.numValues >= size * this.numFrames) return;
    const wanted = rows.slice(size * Math.max(this.firstFrame - first, 0));
    this.numValues += wanted.length;
    this.motion.push(wanted);
  }

  /** Returns the samples, and as many frames as belong to them; null where nothing was kept. */
  result(size: number): { samples: Float32Array<ArrayBuffer>; directions: Float32Array } | null {
    const samples = joined(this.sound);
    const directions = joined(this.motion).slice(0, size * this.numFrames);
    return directions.length ? { samples, directions } : null;
  }

  /** Number of frames that belong to the samples. */
  private get numFrames(): number {
    return Math.round((this.numSamples * this.fps) / RATE);
  }
}
