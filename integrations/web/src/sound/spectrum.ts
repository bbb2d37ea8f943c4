/** Power spectra and mel filters, as `ha2g_jax/features/spectrum.py` computes them. */

const LINEAR_HZ = 1000; // end of the linear part of Slaney's scale
const LINEAR_MEL = 15;
const LOG_STEP = Math.log(6.4) / 27; // of the logarithm of the frequency in a mel above it

/** Fourier transforms of real numbers, with the tables and the memory of one size. */
export class PowerSpectrum {
  private readonly window: Float64Array;
  private readonly cosines: Float64Array; // cos and sin of 2 pi k / size
  private readonly sines: Float64Array;
  private readonly reversed: Uint16Array;
  private readonly real: Float64Array;
  private readonly imaginary: Float64Array;
  private readonly slow: Float64Array[]; // orthonormal vectors that span windowed slow sines
  private readonly column: Float64Array;

  /**
   * @param size - samples of a column, a power of 2.
   * @param slowCycles - numbers of cycles in a column of the sines that are subtracted from it, as the window spreads
   *   them over all frequencies.
   */
  constructor(
    private readonly size: number,
    slowCycles: readonly number[] = [],
  ) {
    const half = size / 2;
    const angles = Float64Array.from({ length: size }, (_, k) => (2 * Math.PI * k) / size);
    this.cosines = angles.map(Math.cos);
    this.sines = angles.map(Math.sin);
    this.window = this.cosines.map((cosine) => 0.5 - 0.5 * cosine); // periodic Hann window
    this.reversed = new Uint16Array(half);
    for (let k = 1; k < half; k++) this.reversed[k] = (this.reversed[k >> 1] >> 1) | (k & 1 ? half >> 1 : 0);
    this.real = new Float64Array(half);
    this.imaginary = new Float64Array(half);
    this.column = new Float64Array(size);
    const waves = [0, Math.PI / 2].flatMap((phase) => slowCycles.map((cycles) => ({ phase, cycles })));
    const sines = waves.filter(({ phase, cycles }) => phase === 0 || cycles > 0);
    this.slow = orthonormal(
      sines.map(({ phase, cycles }) => this.window.map((weight, k) => weight * Math.cos(angles[k] * cycles - phase))),
    );
  }

  /**
   * Computes |FFT|^2 of the windowed samples of one column, each step rounded to float32 as NumPy's.
   *
   * @param samples - sound.
   * @param start - first sample of the column.
   * @param power - (1 + size / 2,) that the powers are written to.
   */
  compute(samples: Float32Array, start: number, power: Float32Array): void {
    const { real, imaginary, cosines, sines, window, reversed, column } = this;
    const half = this.size / 2;
    for (let k = 0; k < this.size; k++) column[k] = window[k] * samples[start + k];
    for (const vector of this.slow) subtractProjection(column, vector);
    // Even samples are the real parts, and odd ones the imaginary parts, of a transform of half the size.
    for (let k = 0; k < half; k++) {
      const to = reversed[k];
      real[to] = column[2 * k];
      imaginary[to] = column[2 * k + 1];
    }
    this.transform();
    for (let k = 0; k <= half; k++) {
      const a = k % half;
      const b = (half - k) % half;
      const evenReal = (real[a] + real[b]) / 2;
      const evenImaginary = (imaginary[a] - imaginary[b]) / 2;
      const oddReal = (imaginary[a] + imaginary[b]) / 2;
      const oddImaginary = (real[b] - real[a]) / 2;
      const x = Math.fround(evenReal + cosines[k] * oddReal + sines[k] * oddImaginary);
      const y = Math.fround(evenImaginary + cosines[k] * oddImaginary - sines[k] * oddReal);
      const size = Math.fround(Math.sqrt(x * x + y * y));
      power[k] = size * size;
    }
  }

  /** Transforms `real` and `imaginary`, whose order is that of reversed bits, in place. */
  private transform(): void {
    const { real, imaginary, cosines, sines } = this;
    const count = this.size / 2;
    for (let span = 1; span < count; span *= 2) {
      const stride = count / span; // of the angle, in units of 2 pi / size
      for (let first = 0; first < count; first += 2 * span) {
        for (let k = 0; k < span; k++) {
          const c = cosines[k * stride];
          const s = sines[k * stride];
          const a = first + k;
          const b = a + span;
          const x = c * real[b] + s * imaginary[b];
          const y = c * imaginary[b] - s * real[b];
          real[b] = real[a] - x;
          imaginary[b] = imaginary[a] - y;
          real[a] += x;
          imaginary[a] += y;
        }
      }
    }
  }
}

/** Subtracts from values, in place, their projection on a vector of length 1. */
function subtractProjection(values: Float64Array, vector: Float64Array): void {
  let product = 0;
  for (let k = 0; k < values.length; k++) product += values[k] * vector[k];
  for (let k = 0; k < values.length; k++) values[k] -= product * vector[k];
}

/** Returns orthonormal vectors that span the given ones (Gram and Schmidt, twice for accuracy). */
function orthonormal(vectors: Float64Array[]): Float64Array[] {
  const found: Float64Array[] = [];
  for (const vector of vectors) {
    for (const other of [...found, ...found]) subtractProjection(vector, other);
    const length = Math.hypot(...vector);
    found.push(vector.map((value) => value / length));
  }
  return found;
}

/** A triangle on Slaney's mel scale: its values, and the number of the first one. */
export interface MelFilter {
  start: number;
  weights: Float32Array;
}

/**
 * Computes triangles on Slaney's mel scale from 0 to half the sample rate, each of area 1.
 *
 * @param sampleRate - samples per second.
 * @param size - samples of a column of the spectrum.
 * @param numMels - number of bands.
 */
export function melFilters(sampleRate: number, size: number, numMels: number): MelFilter[] {
  const edges = melFrequencies(numMels + 2, sampleRate / 2);
  return Array.from({ length: numMels }, (_, band) => {
    const [left, middle, right] = edges.subarray(band, band + 3);
    const triangle = Float32Array.from({ length: 1 + size / 2 }, (_, k) => {
      const frequency = (k * sampleRate) / size;
      return Math.max(Math.min((frequency - left) / (middle - left), (right - frequency) / (right - middle)), 0);
    });
    const start = Math.max(triangle.findIndex((value) => value > 0), 0);
    const end = triangle.findLastIndex((value) => value > 0) + 1;
    return { start, weights: triangle.slice(start, end).map((value) => (value * 2) / (right - left)) };
  });
}

/** Computes frequencies in Hz, (count,), evenly spaced on Slaney's mel scale from 0 to `highest`. */
export function melFrequencies(count: number, highest: number): Float64Array {
  const last = LINEAR_MEL + Math.log(highest / LINEAR_HZ) / LOG_STEP;
  return Float64Array.from({ length: count }, (_, k) => {
    const mel = (last * k) / (count - 1);
    return mel < LINEAR_MEL ? mel * (LINEAR_HZ / LINEAR_MEL) : LINEAR_HZ * Math.exp(LOG_STEP * (mel - LINEAR_MEL));
  });
}
