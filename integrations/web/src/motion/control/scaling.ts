/**
 * Scaling of a motion about a pose, as in `ha2g_jax/motion/control/parts.py`: with a scale of 0 the pose, with 1 the
 * motion, with more beyond the motion.
 */

import { conjugate, multiply, type Numbers, radians, rotate } from "../rotations.js";
import { applyRotations, keyOf, power, type Rotations, rotationsFrom } from "./local-rotations.js";
import type { Part } from "./parts.js";

// A scale above 1 keeps rotations within these angles from the mean pose, in radians, unless the motion itself exceeds
// them; elbows and wrists stay within the limits of their bend.
const FARTHEST: Record<string, number> = { trunk: 0.5, head: 0.9, "upper arm": 2.4, forearm: Math.PI, hand: 1.9 };
const BEND_LIMITS: Record<string, [number, number]> = {
  forearm: [radians(8), radians(145)],
  hand: [-radians(70), radians(70)],
};
const LEAST_HEADROOM = 1e-3;

/**
 * Scales the rotations of a motion from a reference pose.
 *
 * @param reference - (bones, 3) unit vectors.
 * @param directions - (T, bones, 3) unit vectors.
 * @param scale - factor of the angles from 0 to 1.
 * @param chosen - parts to move, including those that they are attached to.
 * @returns (T, bones, 3) unit vectors.
 */
export function scaleAbout(reference: Numbers, directions: Float32Array, scale: number, chosen: Part[]): Float32Array {
  const result = directions.slice();
  if (scale === 1) return result;
  const exponents = new Float64Array(directions.length / reference.length).fill(scale);
  const scaled: Rotations = new Map();
  for (const [key, rotation] of rotationsFrom(reference, directions, chosen)) {
    scaled.set(key, power(rotation, exponents));
  }
  applyRotations(reference, scaled, chosen, result);
  return result;
}

/**
 * Scales the rotations of a motion from mean rotations.
 *
 * A scale above 1 does not change the shape of a hand, and adds less near the limits of a joint.
 *
 * @param reference - (bones, 3) unit vectors.
 * @param directions - (T, bones, 3) unit vectors.
 * @param means - returns the mean (T x 4) of the rotations (T x 4) of a name.
 * @param scale - factor of the angles, at least 0.
 * @param chosen - parts to move, including those that they are attached to.
 * @returns (T, bones, 3) unit vectors.
 */
export function scaleAboutMeans(
  reference: Numbers,
  directions: Float32Array,
  means: (rotation: Numbers, key: string) => Numbers,
  scale: number,
  chosen: Part[],
): Float32Array {
  const rotations = rotationsFrom(reference, directions, chosen);
  const kinds = new Map(chosen.filter((part) => part.kind in FARTHEST).map((part) => [keyOf(part.bones), part]));
  const scaled: Rotations = new Map();
  for (const [key, rotation] of rotations) {
    const mean = means(rotation, key);
    const part = kinds.get(key);
    const exponents = part
      ? partScales(reference, rotation, mean, scale, part)
      : new Float64Array(rotation.length / 4).fill(Math.min(scale, 1));
    scaled.set(key, multiply(mean, power(multiply(conjugate(mean), rotation), exponents)));
  }
  const result = directions.slice();
  applyRotations(reference, scaled, chosen, result);
  return result;
}

/** Returns the limited scale (T) of the rotations of a part. */
function partScales(reference: Numbers, rotation: Numbers, mean: Numbers, scale: number, part: Part): Numbers {
  const frames = rotation.length / 4;
  const scales = new Float64Array(frames);
  for (let frame = 0; frame < frames; frame++) {
    let product = 0;
    for (let k = 4 * frame; k < 4 * frame + 4; k++) product += rotation[k] * mean[k];
    const angle = 2 * Math.acos(Math.min(Math.abs(product), 1));
    scales[frame] = limitScale(scale, angle, FARTHEST[part.kind] - angle);
  }
  const limits = BEND_LIMITS[part.kind];
  if (limits && scale > 1) {
    const along = new Float64Array(3);
    for (const bone of part.bones) {
      for (let k = 0; k < 3; k++) along[k] += reference[3 * bone + k] / part.bones.length;
    }
    const parent = reference.subarray(3 * part.parent, 3 * part.parent + 3);
    const [bends, usual] = [rotation, mean].map((q) => rotate(q, along));
    for (let frame = 0; frame < frames; frame++) {
      const [bend, mid] = [bends, usual].map((vectors) => angle(parent, vectors.subarray(3 * frame, 3 * frame + 3)));
      const headroom = bend > mid ? limits[1] - bend : bend - limits[0];
      scales[frame] = Math.min(scales[frame], limitScale(scale, bend - mid, headroom));
    }
  }
  return scales;
}

/**
 * Limits a scale above 1 so that it adds less than the headroom: 1 + (s - 1) tanh(z) / z with
 * z = (s - 1) rise / headroom.
 */
function limitScale(scale: number, rise: number, headroom: number): number {
  if (scale <= 1) return scale;
  const z = Math.max(((scale - 1) * Math.abs(rise)) / Math.max(headroom, LEAST_HEADROOM), 1e-6);
  return 1 + ((scale - 1) * Math.tanh(z)) / z;
}

/** Returns the angle in radians between vectors (3) of any positive length. */
function angle(a: Numbers, b: Numbers): number {
  const x = a[1] * b[2] - a[2] * b[1];
  const y = a[2] * b[0] - a[0] * b[2];
  const z = a[0] * b[1] - a[1] * b[0];
  return Math.atan2(Math.hypot(x, y, z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
}
