/** Rounding as that of Python and NumPy, on which the number of frames and the inputs of a model depend. */

/** Returns the nearest whole number; of two that are equally near, the even one. */
export function round(value: number): number {
  const floor = Math.floor(value);
  const rest = value - floor;
  return rest > 0.5 || (rest === 0.5 && floor % 2 !== 0) ? floor + 1 : floor;
}

const SMALLEST = 2 ** -14; // the smallest normal number of half precision

/** Returns the nearest number of half precision to a number within -65504 and 65504. */
export function toFloat16(value: number): number {
  const size = Math.abs(value);
  const step = size < SMALLEST ? 2 ** -24 : 2 ** (Math.floor(Math.log2(size)) - 10);
  return round(value / step) * step;
}
