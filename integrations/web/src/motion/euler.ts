/** Intrinsic Euler angles of quaternions (x, y, z, w), as those of scipy's `Rotation`. */

import { about, multiply, row, type Numbers } from "./rotations.js";

export type Order = "XYZ" | "ZXY";

const POLE = 1e-7;

/**
 * Returns intrinsic Euler angles (n x 3) in radians of quaternions (n x 4).
 *
 * At the pole only a sum of angles is defined; there the third is 0.
 *
 * @param order - axes of the three rotations; each is that of the already rotated axes.
 */
export function toEuler(q: Numbers, order: Order): Numbers {
  // Bernardes and Viollet, "Quaternion to Euler angles conversion", 2022; the rotations are taken from the last one on.
  const [k, j, i] = [...order].map((axis) => "XYZ".indexOf(axis)) as [number, number, number];
  const sign = ((i - j) * (j - k) * (k - i)) / 2;
  const out = new Float64Array((q.length / 4) * 3);
  for (let frame = 0; frame < q.length / 4; frame++) {
    const own = row(q, frame, 4);
    const a = own[3] - own[j];
    const b = own[i] + own[k] * sign;
    const c = own[j] + own[3];
    const d = own[k] * sign - own[i];
    const second = 2 * Math.atan2(Math.hypot(c, d), Math.hypot(a, b));
    const sum = Math.atan2(b, a);
    const difference = Math.atan2(d, c);
    const angles =
      second <= POLE
        ? [0, 2 * sum * sign]
        : second >= Math.PI - POLE
          ? [0, 2 * difference * sign]
          : [sum - difference, (sum + difference) * sign];
    out.set([within(angles[1]), second - Math.PI / 2, within(angles[0])], 3 * frame);
  }
  return out;
}

/** Returns the quaternions (n x 4) of intrinsic Euler angles (n x 3) in radians, the inverse of `toEuler`. */
export function fromEuler(angles: Numbers, order: Order): Numbers {
  const turns = [...order].map((axis, place) => {
    const vector = Float64Array.from([..."XYZ"], (name) => Number(name === axis));
    return about(vector, angles.filter((_, k) => k % 3 === place));
  });
  return multiply(multiply(turns[0], turns[1]), turns[2]);
}

function within(angle: number): number {
  if (angle < -Math.PI) return angle + 2 * Math.PI;
  return angle > Math.PI ? angle - 2 * Math.PI : angle;
}
