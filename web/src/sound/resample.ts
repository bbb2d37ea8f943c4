/** Change of the sample rate of sound. */

/**
 * Resamples sound.
 *
 * @param samples - (samples,) of one channel.
 * @param rate - samples per second.
 * @param newRate - samples per second of the result.
 * @returns (round(samples x newRate / rate),).
 */
export function resample(samples: Float32Array, rate: number, newRate = 16000): Float32Array {
  throw new Error(`not built yet: ${samples} ${rate} ${newRate}`);
}
