/**
 * The log-mel spectrogram of speech that arrives in pieces, in memory that does not grow, as
 * `RunningMel` of `ha2g_jax/features/spectrum.py` computes it.
 *
 * Its columns are those of `logMel`. Only 0 dB differs: the maximum of a clip is not known before its end, so that 0 dB
 * is a running level, which each window takes as it is at its time.
 */

import { joined } from "../arrays.js";
import { toFloat16 } from "../rounding.js";
import { decibels, HOP_LENGTH, melPower, NUM_MELS, SAMPLE_RATE, SOUND_DB, TYPICAL_POWER } from "./mel.js";

// 0 dB falls slowly while there is sound; it does not fall in pauses.
const FALL = 10 ** ((-0.2 / 10) * (HOP_LENGTH / SAMPLE_RATE)); // by 0.2 dB in a second of sound

/** The last columns of the spectrogram of speech that goes on. */
export class RunningMel {
  private reference: number;
  private readonly isRunning: boolean;
  private readonly powers: Float32Array; // (kept, 128), the latest column last; silence before the first
  private readonly isSound: Uint8Array; // of the same columns
  private numColumns = 1; // that were computed since the start; the first one is silence
  private samples: Float32Array = new Float32Array(0); // those that later columns need, from number `first` on
  private first = 0;

  /**
   * @param kept - number of columns that are kept.
   * @param reference - mel power of 0 dB; by default a running level that starts at that of typical speech.
   */
  constructor(
    private readonly kept: number,
    reference?: number,
  ) {
    this.reference = reference ?? TYPICAL_POWER;
    this.isRunning = reference === undefined;
    this.powers = new Float32Array(kept * NUM_MELS);
    this.isSound = new Uint8Array(kept);
  }

  /** Lets all sound so far be silence, of a number of samples; the level of 0 dB stays. */
  restart(numSamples: number): void {
    this.powers.fill(0);
    this.isSound.fill(0);
    this.numColumns = Math.max(Math.floor(numSamples / HOP_LENGTH), 1);
    this.first = HOP_LENGTH * (this.numColumns - 1);
    this.samples = new Float32Array(numSamples - this.first);
  }

  /** Adds samples at 16 kHz to the end, and computes the columns that they complete. */
  add(samples: Float32Array): void {
    const known = joined([this.samples, samples]);
    while (HOP_LENGTH * (this.numColumns + 1) <= this.first + known.length) {
      this.addColumn(known, HOP_LENGTH * (this.numColumns - 1) - this.first);
    }
    const done = HOP_LENGTH * (this.numColumns - 1) - this.first;
    this.samples = known.slice(done);
    this.first += done;
  }

  /**
   * Returns columns of the spectrogram at half precision.
   *
   * @param start - number of the first column, which may lie before the start of the speech.
   * @param columns - number of columns.
   * @returns (128, columns) dB; columns before the start, and those that are not computed, are silence.
   */
  window(start: number, columns: number): Float32Array {
    const window = new Float32Array(NUM_MELS * columns);
    const first = this.kept - this.numColumns + start; // row of the first column in `powers`
    for (let column = 0; column < columns; column++) {
      const row = start + column < this.numColumns ? first + column : -1;
      for (let band = 0; band < NUM_MELS; band++) {
        const power = row < 0 ? 0 : this.powers[row * NUM_MELS + band];
        window[band * columns + column] = toFloat16(decibels(power, this.reference));
      }
    }
    return window;
  }

  /** Returns whether one of the kept columns from `start` on and before `end` is within 30 dB of 0 dB. */
  hasSound(start: number, end: number): boolean {
    const first = this.kept - this.numColumns;
    return this.isSound.subarray(Math.max(first + start, 0), Math.max(first + end, 0)).includes(1);
  }

  private addColumn(samples: Float32Array, start: number): void {
    this.powers.copyWithin(0, NUM_MELS);
    const latest = this.powers.subarray(-NUM_MELS);
    melPower(samples, start, latest);
    this.numColumns++;
    const loudest = Math.max(...latest);
    const isSound = decibels(loudest, this.reference) > SOUND_DB;
    this.isSound.copyWithin(0, 1);
    this.isSound[this.kept - 1] = Number(isSound);
    if (this.isRunning && isSound) this.reference = Math.max(loudest, this.reference * FALL);
  }
}
