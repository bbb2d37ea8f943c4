/** Noise over time, a function of the seed and of the number of the frame, as in `ha2g_jax/features/noise.py`. */

const PERIODS = [2, 0.5]; // seconds between independent values, of the first and of the second half of the channels

/**
 * Computes noise that is normal with mean 0 and variance 1 at each moment, and changes smoothly.
 *
 * @param seed - whole number below 2^32.
 * @param first - number of the first frame, from 0 on at the start of a clip; it may be negative.
 * @param count - number of frames.
 * @param fps - frames per second.
 * @param dim - number of channels.
 * @returns (count, dim) values.
 */
export function noiseTrack(seed: number, first: number, count: number, fps: number, dim: number): Float32Array {
  const noise = new Float32Array(count * dim);
  for (let channel = 0; channel < dim; channel++) {
    const period = PERIODS[Number(channel >= Math.floor(dim / 2))];
    for (let k = 0; k < count; k++) {
      const place = (first + k) / (fps * period) + channel / dim;
      const before = Math.floor(place);
      const moment = place - before;
      const angle = (Math.PI / 2) * moment ** 2 * (3 - 2 * moment);
      const [start, end] = [before, before + 1].map((point) => normal(seed, point, channel));
      noise[k * dim + channel] = start * Math.cos(angle) + end * Math.sin(angle);
    }
  }
  return noise;
}

/** Returns the normal value of a point of the lattice, from two hashes of it (Box and Muller 1958). */
export function normal(seed: number, point: number, channel: number): number {
  const mixed = mix(mix(seed) + point);
  const [radius, angle] = [0, 1].map((half) => (mix(mixed + 2 * channel + half) + 0.5) / 2 ** 32);
  return Math.sqrt(-2 * Math.log(radius)) * Math.cos(2 * Math.PI * angle);
}

/** Mixes the bits of a whole number modulo 2^32 (the hash "lowbias32" of Wellons 2018). */
function mix(number: number): number {
  let bits = number >>> 0;
  bits = Math.imul(bits ^ (bits >>> 16), 0x7feb352d);
  bits = Math.imul(bits ^ (bits >>> 15), 0x846ca68b);
  return (bits ^ (bits >>> 16)) >>> 0;
}
