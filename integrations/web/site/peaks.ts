/** The waveform below the figure. */

export const PEAK_RATE = 50; // peaks per second

/** Returns the largest absolute sample of each 20 ms, 255 for the largest of all. */
export function peaksOf(samples: Float32Array, rate: number): Uint8Array {
  const step = rate / PEAK_RATE;
  const peaks = new Float32Array(Math.ceil(samples.length / step));
  samples.forEach((sample, i) => {
    const at = Math.floor(i / step);
    peaks[at] = Math.max(peaks[at], Math.abs(sample));
  });
  const most = peaks.reduce((most, peak) => Math.max(most, peak), 1e-6);
  return Uint8Array.from(peaks, (peak) => Math.round((255 * peak) / most));
}
