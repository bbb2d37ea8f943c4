/** Change of the sample rate of sound, with the filter of soxr's quality HQ, which Python uses. */

import { round } from "../rounding.js";
import { checkArray } from "./speech.js";

// The filter is a sinc under a Kaiser window. Its passband ends at 0.913 of half the lower rate, and its stopband
// begins at half the lower rate, 120 dB below.
const CUTOFF = 0.95687; // of half the lower rate
const BETA = 13.04;
const REACH = 96.833; // samples of the lower rate on either side
const MOST_PHASES = 1024; // filters that are computed; those between them are interpolated

/**
 * Resamples sound.
 *
 * @param samples - (samples,) of one channel.
 * @param rate - samples per second, 1000 to 768000.
 * @param newRate - samples per second of the result.
 * @returns (round(samples x newRate / rate),).
 */
export function resample(samples: Float32Array, rate: number, newRate = 16000): Float32Array {
  checkArray(samples);
  if (!(rate >= 1000 && rate <= 768000)) {
    throw new Error(`the sound has ${rate} samples per second; expected 1000 to 768000`);
  }
  if (rate === newRate) return samples;
  const step = rate / newRate;
  const reach = Math.ceil(REACH * Math.max(step, 1)); // samples of the input on either side
  const phases = Math.min(newRate / commonDivisor(Math.round(rate), newRate), MOST_PHASES);
  const filters = Array.from({ length: phases + 1 }, (_, phase) => phaseFilter(phase / phases, reach, step));
  const result = new Float32Array(round((samples.length * newRate) / rate));
  for (let k = 0; k < result.length; k++) {
    const before = Math.floor((k * rate) / newRate);
    const place = ((k * rate) / newRate - before) * phases;
    const phase = Math.floor(place + 1e-6);
    const weight = place - phase;
    const first = before - reach;
    const here = convolved(samples, first, filters[phase]);
    result[k] = weight > 1e-6 ? here + weight * (convolved(samples, first, filters[phase + 1]) - here) : here;
  }
  return result;
}

/** Returns the weights of the samples from `reach` before to `reach` + 1 after, for a moment between two samples. */
function phaseFilter(fraction: number, reach: number, step: number): Float32Array {
  const scale = 1 / Math.max(step, 1);
  return Float32Array.from({ length: 2 * reach + 2 }, (_, k) => {
    const distance = (k - reach - fraction) * scale; // in samples of the lower rate
    const inside = 1 - (distance / REACH) ** 2;
    if (inside <= 0) return 0;
    const angle = Math.PI * CUTOFF * distance;
    const sinc = Math.abs(angle) < 1e-9 ? 1 : Math.sin(angle) / angle;
    return (scale * CUTOFF * sinc * bessel(BETA * Math.sqrt(inside))) / bessel(BETA);
  });
}

/** Returns the sum of samples from number `first` on, which may lie before the first one, times weights. */
function convolved(samples: Float32Array, first: number, weights: Float32Array): number {
  const end = Math.min(weights.length, samples.length - first);
  let sum = 0;
  for (let k = Math.max(-first, 0); k < end; k++) sum += weights[k] * samples[first + k];
  return sum;
}

/** Computes the modified Bessel function of the first kind and order 0. */
function bessel(x: number): number {
  let sum = 1;
  for (let k = 1, term = 1; term > 1e-17 * sum; k++) {
    term *= (x / (2 * k)) ** 2;
    sum += term;
  }
  return sum;
}

function commonDivisor(a: number, b: number): number {
  return b ? commonDivisor(b, a % b) : a;
}
