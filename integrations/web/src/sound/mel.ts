/** The log-mel spectrogram of the models, as `ha2g_jax/features/spectrum.py` computes it. */

import { round, toFloat16 } from "../rounding.js";
import { melFilters, PowerSpectrum } from "./spectrum.js";

export const SAMPLE_RATE = 16000;
export const FFT_SIZE = 1024;
export const HOP_LENGTH = 512;
export const NUM_MELS = 128;
export const FLOOR_DB = -80;
export const SOUND_DB = -30; // a column whose loudest band is louder is sound

/** The loudest mel power of speech with a peak of about 0.2, and the least mel power of 0 dB. */
export const TYPICAL_POWER = 15;
const LEAST_POWER = TYPICAL_POWER / 1000;
const FIRST_HEARD = Math.ceil((80 * FFT_SIZE) / SAMPLE_RATE); // a constant, rumble and hum below 80 Hz count for nothing
const LEAST_RATIO = Math.fround(1e-8); // of the floor

const SLOW_CYCLES = [0, 0.5, 1, 1.5, 2, 2.5]; // of the sines in a column that are subtracted

const spectrum = new PowerSpectrum(FFT_SIZE, SLOW_CYCLES);
const filters = melFilters(SAMPLE_RATE, FFT_SIZE, NUM_MELS);
const power = new Float32Array(1 + FFT_SIZE / 2);

/**
 * Computes the mel powers of one column of the spectrogram.
 *
 * @param samples - sound at 16 kHz.
 * @param start - first of the 1024 samples of the column.
 * @param mel - (128,) that the powers are written to.
 */
export function melPower(samples: Float32Array, start: number, mel: Float32Array): void {
  spectrum.compute(samples, start, power);
  power.fill(0, 0, FIRST_HEARD);
  for (let band = 0; band < NUM_MELS; band++) {
    const filter = filters[band];
    let sum = 0;
    for (let k = 0; k < filter.weights.length; k++) sum += filter.weights[k] * power[filter.start + k];
    mel[band] = sum;
  }
}

/**
 * Computes the log-mel spectrogram of a clip in dB relative to its maximum, or to `LEAST_POWER` if that is greater.
 *
 * A clip that is nowhere within 30 dB of 0 dB is silence.
 *
 * @param samples - (samples,) at 16 kHz, at least 1 sample.
 * @returns (1 + floor(samples / 512), 128) in [-80, 0], one column of the spectrogram after the other.
 */
export function logMel(samples: Float32Array): Float32Array {
  const columns = 1 + Math.floor(samples.length / HOP_LENGTH);
  const powers = new Float32Array(columns * NUM_MELS); // the first and the last column are silence
  for (let column = 1; column < columns - 1; column++) {
    melPower(samples, (column - 1) * HOP_LENGTH, powers.subarray(column * NUM_MELS, (column + 1) * NUM_MELS));
  }
  const loudest = powers.reduce((most, value) => Math.max(most, value), 0);
  if (decibels(loudest, loudest) <= SOUND_DB) return powers.fill(FLOOR_DB);
  return powers.map((value) => decibels(value, loudest));
}

/** Returns a mel power in dB relative to a reference power of at least `LEAST_POWER`, in [-80, 0]. */
export function decibels(value: number, reference: number): number {
  const zero = Math.fround(Math.max(reference, LEAST_POWER));
  const ratio = Math.min(Math.max(Math.fround(value / zero), LEAST_RATIO), 1);
  return Math.min(Math.max(Math.fround(10 * Math.fround(Math.log10(ratio))), FLOOR_DB), 0);
}

/**
 * Returns the window of a spectrogram that starts at a frame, as a model reads it, at half precision.
 *
 * @param mel - (columns, 128) of a whole clip in dB.
 * @param startFrame - first frame of the window.
 * @param columns - columns of the window.
 * @param fps - frames per second.
 * @returns (128, columns); past the end of the clip there is silence.
 */
export function melWindow(mel: Float32Array, startFrame: number, columns: number, fps: number): Float32Array {
  const start = windowColumn(startFrame, fps);
  const window = new Float32Array(NUM_MELS * columns).fill(FLOOR_DB);
  const known = Math.min(mel.length / NUM_MELS - start, columns);
  for (let column = 0; column < known; column++) {
    for (let band = 0; band < NUM_MELS; band++) {
      window[band * columns + column] = toFloat16(mel[(start + column) * NUM_MELS + band]);
    }
  }
  return window;
}

/** Returns the column of the spectrogram nearest to the time of a frame. */
export function windowColumn(frame: number, fps: number): number {
  return round((frame * SAMPLE_RATE) / (fps * HOP_LENGTH));
}

/** Returns the number of whole columns of the spectrogram in a number of frames. */
export function windowColumns(numFrames: number, fps: number): number {
  return Math.trunc((numFrames * SAMPLE_RATE) / (fps * HOP_LENGTH));
}
