/**
 * Voice and the ends of phrases in sound that arrives in pieces: what someone who listens nods at, as in
 * `ha2g_jax/features/phrases.py`.
 */

import { round } from "../rounding.js";
import { FFT_SIZE, HOP_LENGTH, LEAST_POWER, melPower, NUM_MELS, SAMPLE_RATE, TYPICAL_POWER } from "./mel.js";
import { melFrequencies } from "./spectrum.js";

const PAUSE = 0.3; // seconds without voice that end a phrase
const LEAST_PHRASE = 1; // seconds of the shortest phrase whose end counts
const KEPT = 4; // seconds of sound that are remembered
const VOICE_HZ = [150, 4000];
const [ABOVE_FLOOR_DB, BELOW_PEAK_DB] = [9, 27];
const FALL_DB = 1; // of the peak per second of voice
const COLUMN = HOP_LENGTH / SAMPLE_RATE; // seconds
const CENTRES = melFrequencies(NUM_MELS + 2, SAMPLE_RATE / 2).slice(1, -1);
const [FIRST, END] = VOICE_HZ.map((hertz) => CENTRES.findIndex((centre) => centre >= hertz));

/** Voice and the ends of phrases of sound that arrives in pieces, in memory that does not grow. */
export class Phrases {
  /** Times in seconds of the ends of phrases of at least a second in the last four, which a pause has followed. */
  ends: number[] = [];
  private numColumns: number;
  private samples: Float32Array; // from half a column before the next one on
  private readonly isVoice: boolean[]; // the latest column last
  private readonly levels: number[];
  private peak = decibels(TYPICAL_POWER);
  private phrase: [first: number, last: number] | undefined; // columns with voice

  /** Begins after samples of silence. */
  constructor(numSamples: number) {
    this.numColumns = Math.floor(numSamples / HOP_LENGTH);
    this.samples = new Float32Array((numSamples % HOP_LENGTH) + HOP_LENGTH);
    const count = Math.round(KEPT / COLUMN);
    this.isVoice = new Array(count).fill(false);
    this.levels = new Array(count).fill(decibels(0));
  }

  /** Adds samples at 16 kHz to the end. */
  add(samples: Float32Array): void {
    const known = new Float32Array(this.samples.length + samples.length);
    known.set(this.samples);
    known.set(samples, this.samples.length);
    let start = 0;
    for (; start + FFT_SIZE <= known.length; start += HOP_LENGTH) this.addColumn(known, start);
    this.samples = known.slice(start);
  }

  /** Returns whether there is voice between two times in seconds, of which the last four seconds are known. */
  hasVoice(start: number, end: number): boolean {
    const first = this.isVoice.length - this.numColumns;
    const [from, to] = [start, end].map((time) => Math.max(first + round(time / COLUMN), 0));
    return this.isVoice.slice(from, to).includes(true);
  }

  private addColumn(samples: Float32Array, start: number): void {
    const power = new Float32Array(NUM_MELS);
    melPower(samples, start, power);
    const level = decibels(power.subarray(FIRST, END).reduce((sum, value) => sum + value, 0) / (END - FIRST));
    const isVoice = level > Math.max(Math.min(...this.levels) + ABOVE_FLOOR_DB, this.peak - BELOW_PEAK_DB);
    this.levels.shift();
    this.levels.push(level);
    this.isVoice.shift();
    this.isVoice.push(isVoice);
    if (isVoice) {
      this.peak = Math.max(level, this.peak - FALL_DB * COLUMN);
      this.phrase = [this.phrase?.[0] ?? this.numColumns, this.numColumns];
    } else if (this.phrase && (this.numColumns - this.phrase[1]) * COLUMN >= PAUSE) {
      const [begun, ended] = [(this.phrase[0] - 0.5) * COLUMN, (this.phrase[1] + 0.5) * COLUMN];
      if (ended - begun >= LEAST_PHRASE) this.ends.push(ended);
      this.phrase = undefined;
    }
    this.numColumns++;
    this.ends = this.ends.filter((end) => this.numColumns * COLUMN - end < KEPT);
  }
}

function decibels(power: number): number {
  return 10 * Math.log10(Math.max(power, LEAST_POWER / 1000));
}
