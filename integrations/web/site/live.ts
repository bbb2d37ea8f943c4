/** Motion that follows the microphone: the frame that is shown is that of what was said a stated time ago. */

import { joined } from "../src/arrays.js";
import type { LiveStream } from "../src/synthesis/gesturer.js";
import type { ShownFigure } from "./figure.js";
import { Recording } from "./recording.js";
import { RATE } from "./sound.js";

const BUFFER = 0.15; // seconds beyond the stated latency
const SPARE = 0.05; // seconds that the delay gets beyond a frame that came late
const MOST_DELAY = 10; // seconds
const TOO_SLOW = "This device computes more slowly than you speak; close other programs, or use a sound file.";

/** Something with a clock whose sound a run takes: the microphone, or a test. */
export interface Source {
  readonly time: number;
  begin(take: (samples: Float32Array) => void, onend: (reason: string) => void): void;
  close(): void;
}

export class LiveRun {
  /** Seconds from a moment of the sound to the image that shows it. */
  delay: number;
  /** Frames that came after their time. */
  late = 0;
  /** Loudest sample of the last moment, falling slowly. */
  level = 0;
  recording: Recording | null = null;
  private pending: [own: Float32Array, other: Float32Array][] = [];
  private waiting = 0;
  private numFrames = 0;
  private numSamples = 0;
  private work: Promise<void> | null = null;
  private isClosed = false;

  /**
   * @param voice - says whether the sound is that of the person whom the figure listens to, and not that of the figure.
   * @param onfail - is called with a sentence for people when the run cannot go on.
   */
  constructor(
    private readonly source: Source,
    readonly stream: LiveStream,
    private readonly figure: ShownFigure,
    private readonly voice: { readonly isOther: boolean },
    private readonly onfail: (reason: string) => void,
  ) {
    this.delay = stream.latency + BUFFER;
    figure.clear();
    source.begin(
      (samples) => this.take(samples),
      (reason) => this.fail(reason),
    );
  }

  /** Number of the frame that is shown now, null before the first. */
  get number(): number | null {
    return this.numFrames ? Math.max(this.source.time - this.delay, 0) * this.figure.fps : null;
  }

  get numBones(): number {
    return this.figure.bones.length;
  }

  /** Keeps sound and motion from now on. */
  record(): void {
    this.recording = new Recording(this.figure.fps, this.numSamples);
  }

  /** Ends what the figure says: its sound of which no frame has come becomes silence. */
  interrupt(): void {
    for (const [own] of this.pending) own.fill(0);
    this.stream.clear().catch((error: Error) => this.fail(error.message));
  }

  /** Ends the run, and returns its recording with the frames that belong to it. */
  async end(): Promise<Recording | null> {
    const { recording } = this;
    this.isClosed = true;
    this.source.close();
    await this.work;
    const rest = recording && (await this.stream.flush().catch(() => null)); // a stream that has failed has none
    if (rest) this.keep(rest);
    this.stream.close();
    return recording;
  }

  private take(samples: Float32Array): void {
    if (this.isClosed) return;
    const loudest = samples.reduce((most, sample) => Math.max(most, Math.abs(sample)), 0);
    this.level = Math.max(Math.sqrt(loudest), 0.8 * this.level);
    const silence = new Float32Array(samples.length);
    this.pending.push(this.voice.isOther ? [silence, samples] : [samples, silence]);
    this.waiting += samples.length;
    if (this.waiting > RATE * MOST_DELAY) this.fail(TOO_SLOW);
    else this.work ??= this.compute().finally(() => (this.work = null));
  }

  /** Gives the stream what has arrived, one piece after the other. */
  private async compute(): Promise<void> {
    try {
      while (this.pending.length && !this.isClosed) {
        const pieces = this.pending.splice(0);
        const own = joined(pieces.map(([own]) => own));
        const other = joined(pieces.map(([, other]) => other));
        this.waiting = 0;
        const rows = await this.stream.feed(own, other);
        this.numSamples += own.length;
        this.recording?.hear(own.map((sample, k) => sample + other[k]));
        if (rows.length) this.isClosed ? this.keep(rows) : this.show(rows);
      }
    } catch (error) {
      this.fail((error as Error).message);
    }
  }

  private show(rows: Float32Array): void {
    const { figure } = this;
    const size = 3 * figure.bones.length;
    const first = this.numFrames;
    const late = this.source.time - this.delay - (first - 1) / figure.fps;
    const frames = Array.from({ length: rows.length / size }, (_, i) => rows.subarray(size * i, size * (i + 1)));
    figure.add(first, frames);
    this.keep(rows);
    if (first === 0 || late <= 0) return;
    this.late += frames.length;
    this.delay += late + SPARE;
    if (this.delay > MOST_DELAY) this.fail(TOO_SLOW);
    else figure.ease();
  }

  private keep(rows: Float32Array): void {
    this.recording?.see(this.numFrames, rows, 3 * this.figure.bones.length);
    this.numFrames += rows.length / (3 * this.figure.bones.length);
  }

  private fail(reason: string): void {
    if (!this.isClosed) this.onfail(reason);
  }
}
