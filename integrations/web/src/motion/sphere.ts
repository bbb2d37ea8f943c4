/**
 * Geometry of unit vectors, as in `ha2g_jax/motion/resample.py`.
 *
 * Arrays are flat, n vectors (n x 3).
 */

// Below this angle a straight line and the great circle agree to float precision; above the other, the great circle
// between two opposite vectors is not defined.
const MIN_ANGLE = 1e-4;
const MAX_ANGLE = Math.PI - 1e-3;

type Vectors = ArrayLike<number>;

/**
 * Interpolates between unit vectors on the sphere.
 *
 * @param first - (n, 3) unit vectors.
 * @param second - (n, 3) unit vectors.
 * @param fraction - 0 gives `first`, 1 gives `second`.
 * @returns (n, 3) unit vectors; between opposite vectors, which have no shortest arc, the nearer of the two.
 */
export function slerp(first: Vectors, second: Vectors, fraction: number): Float64Array {
  const mixed = new Float64Array(first.length);
  for (let at = 0; at < first.length; at += 3) {
    const angle = angleBetween(first, second, at);
    let [a, b] = [1 - fraction, fraction];
    if (angle >= MAX_ANGLE) [a, b] = fraction < 0.5 ? [1, 0] : [0, 1];
    else if (angle > MIN_ANGLE) [a, b] = [Math.sin(a * angle) / Math.sin(angle), Math.sin(b * angle) / Math.sin(angle)];
    const x = a * first[at] + b * second[at];
    const y = a * first[at + 1] + b * second[at + 1];
    const z = a * first[at + 2] + b * second[at + 2];
    const length = Math.sqrt(x * x + y * y + z * z);
    mixed[at] = x / length;
    mixed[at + 1] = y / length;
    mixed[at + 2] = z / length;
  }
  return mixed;
}

/** Returns the angle in radians between the unit vectors at a place of two arrays. */
export function angleBetween(first: Vectors, second: Vectors, at = 0): number {
  const [x, y, z] = [first[at], first[at + 1], first[at + 2]];
  const [u, v, w] = [second[at], second[at + 1], second[at + 2]];
  return 2 * Math.atan2(Math.hypot(x - u, y - v, z - w), Math.hypot(x + u, y + v, z + w));
}
