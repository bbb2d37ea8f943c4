/** Checks on the speech that motion is generated for. */

import { SAMPLE_RATE } from "./mel.js";

const LEAST_SECONDS = 0.2;
const MOST_SECONDS = 3900;
const CANCELLED = 0.1; // ratio of powers below which a mean of channels is not that of independent sounds
const INAUDIBLE = 2e-4; // range of the samples of silence: a few steps of 16 bits
const INFINITE = 1e30; // greater samples would overflow in sums of them

/**
 * Checks the length of sound.
 *
 * @param numSamples - samples of each channel.
 * @param rate - samples per second.
 * @throws Error if it is shorter than 0.2 s or longer than 65 minutes.
 */
export function checkLength(numSamples: number, rate: number): void {
  const seconds = numSamples / rate;
  if (!(seconds >= LEAST_SECONDS)) {
    throw new Error(`the sound has ${seconds.toFixed(3)} s; expected at least ${LEAST_SECONDS} s of speech`);
  }
  if (seconds > MOST_SECONDS) {
    throw new Error(`the sound has more than ${MOST_SECONDS / 60} minutes; cut it into shorter parts`);
  }
}

/**
 * Returns samples in which those that are NaN or infinite are 0; the input itself where all are finite.
 *
 * @throws Error if none is finite.
 */
export function finite(samples: Float32Array): Float32Array {
  const isFinite = (sample: number) => Math.abs(sample) < INFINITE;
  if (samples.every(isFinite)) return samples;
  if (!samples.some(isFinite)) throw new Error("the sound has only NaN or infinite samples; record it again");
  return samples.map((sample) => (isFinite(sample) ? sample : 0));
}

/**
 * Returns whether channels cancel each other in their mean, as where one of them is another upside down.
 *
 * @param power - sum of the squares of the mean.
 * @param powers - sum of the squares of each channel.
 */
export function isCancelled(power: number, powers: readonly number[]): boolean {
  return power < (CANCELLED * powers.reduce((sum, each) => sum + each, 0)) / powers.length ** 2;
}

/** Returns whether nothing is to be heard in samples, which may have a constant. */
export function isSilent(samples: Float32Array): boolean {
  let [least, most] = [1, -1];
  for (const sample of samples) {
    least = Math.min(least, sample);
    most = Math.max(most, sample);
  }
  return most - least < INAUDIBLE;
}

/** Checks that samples are floating-point numbers, as those of an Int16Array are not within -1 and 1. */
export function checkArray(samples: Float32Array): void {
  if (samples?.[Symbol.toStringTag] !== "Float32Array") {
    throw new Error("the sound is no Float32Array; expected mono samples within -1 and 1");
  }
}

/**
 * Checks mono samples at 16 kHz.
 *
 * @returns the samples, with 0 for those that are not finite.
 */
export function checkSpeech(samples: Float32Array): Float32Array {
  checkArray(samples);
  checkLength(samples.length, SAMPLE_RATE);
  return finite(samples);
}
