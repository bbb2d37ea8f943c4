/** Rounding as that of Python and NumPy, on which the number of frames and the inputs of a model depend. */

/** Returns the nearest whole number; of two that are equally near, the even one. */
export function round(value: number): number {
  const floor = Math.floor(value);
  const rest = value - floor;
  return rest > 0.5 || (rest === 0.5 && floor % 2 !== 0) ? floor + 1 : floor;
}

const SMALLEST = 2 ** -14; // the smallest normal number of half precision
const number = new Float32Array(1);
const bits = new Int32Array(number.buffer);

/** Returns the nearest number of half precision to a number of single precision within -65504 and 65504. */
export function toFloat16(value: number): number {
  if (Math.abs(value) < SMALLEST) return Math.fround(value + 0.75) - 0.75; // the steps are those of 0.5 to 1
  number[0] = value;
  bits[0] = (bits[0] + 0xfff + ((bits[0] >>> 13) & 1)) & ~0x1fff; // 13 bits fewer; of two that are near, the even one
  return number[0];
}
