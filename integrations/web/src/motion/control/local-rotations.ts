/**
 * Conversion of a motion to the rotations of its parts from a reference pose, and back, as in
 * `ha2g_jax/motion/control/parts.py`.
 *
 * The rotation of each part is relative to the part it is attached to, so that a pose with scaled rotations still has a
 * hand of the right shape on its arm.
 */

import { fit } from "../fitting.js";
import { between, conjugate, IDENTITY, multiply, type Numbers, rotate } from "../rotations.js";
import type { Part } from "./parts.js";

// The rotation of a head or a hand is continued in its direction up to this angle; beyond it the short way is taken.
const LONGEST = 1.3 * Math.PI;

/** Unit quaternions (T x 4) by the numbers of the bones that rotate together. */
export type Rotations = Map<string, Numbers>;

/** Returns the name in `Rotations` of bones that rotate together. */
export function keyOf(bones: number[]): string {
  return bones.join();
}

/**
 * Computes the rotations of parts from a reference pose to the poses of a motion.
 *
 * @param reference - (bones, 3) unit vectors.
 * @param directions - (T, bones, 3) unit vectors.
 * @param chosen - parts to convert, including those that they are attached to.
 * @returns the rotations of each bone, and of all bones of a head or a hand together. The latter are continuous over
 *   time and so may have w < 0, which stands for an angle above pi.
 */
export function rotationsFrom(reference: Numbers, directions: ArrayLike<number>, chosen: Part[]): Rotations {
  const frames = new Map<number, Numbers>([[-1, IDENTITY]]);
  const rotations: Rotations = new Map();
  for (const part of chosen) {
    let frame = frames.get(part.parent)!;
    const poses = part.bones.map((bone) => track(directions, reference.length, bone));
    if (part.kind === "head" || part.kind === "hand") {
      const references = part.bones.map((bone) => reference.subarray(3 * bone, 3 * bone + 3));
      const { fitted } = fit(poses.map((pose) => rotate(conjugate(frame), pose)), references);
      rotations.set(keyOf(part.bones), continuous(fitted));
      frame = multiply(frame, rotations.get(keyOf(part.bones))!);
    }
    part.bones.forEach((bone, k) => {
      const rotation = between(reference.subarray(3 * bone, 3 * bone + 3), rotate(conjugate(frame), poses[k]));
      rotations.set(keyOf([bone]), part.kind === "upper arm" ? continuous(rotation) : rotation);
      frames.set(bone, multiply(frame, rotation));
    });
  }
  return rotations;
}

/**
 * Rotates the parts of a reference pose, the inverse of `rotationsFrom`.
 *
 * @param reference - (bones, 3) unit vectors.
 * @param rotations - rotations of the parts.
 * @param chosen - parts to rotate, including those that they are attached to.
 * @param result - (T, bones, 3) that the directions of these parts are written to.
 */
export function applyRotations(reference: Numbers, rotations: Rotations, chosen: Part[], result: Float32Array): void {
  const frames = new Map<number, Numbers>([[-1, IDENTITY]]);
  for (const part of chosen) {
    let frame = frames.get(part.parent)!;
    if (part.kind === "head" || part.kind === "hand") frame = multiply(frame, rotations.get(keyOf(part.bones))!);
    for (const bone of part.bones) {
      frames.set(bone, multiply(frame, rotations.get(keyOf([bone]))!));
      const vectors = rotate(frames.get(bone)!, reference.subarray(3 * bone, 3 * bone + 3));
      for (let k = 0; k < vectors.length; k++) {
        result[Math.floor(k / 3) * reference.length + 3 * bone + (k % 3)] = vectors[k];
      }
    }
  }
}

/** Scales the angles of rotations (T x 4) by factors (T); one with w < 0 stands for the angle above pi. */
export function power(rotation: Numbers, exponents: Numbers): Numbers {
  const scaled = new Float64Array(rotation.length);
  for (let at = 0; at < rotation.length; at += 4) {
    const length = Math.hypot(rotation[at], rotation[at + 1], rotation[at + 2]);
    const half = exponents[at / 4] * Math.atan2(length, rotation[at + 3]);
    for (let k = at; k < at + 3; k++) scaled[k] = (rotation[k] / Math.max(length, 1e-12)) * Math.sin(half);
    scaled[at + 3] = Math.cos(half);
  }
  return scaled;
}

/** Returns the vectors (T x 3) of one bone; `size` numbers are a frame. */
function track(directions: ArrayLike<number>, size: number, bone: number): Numbers {
  const frames = directions.length / size;
  return Float64Array.from({ length: 3 * frames }, (_, k) => directions[Math.floor(k / 3) * size + 3 * bone + (k % 3)]);
}

/** Returns the same rotations (T x 4) with signs that are continuous over time up to the longest angle. */
function continuous(rotations: Numbers): Numbers {
  const least = Math.cos(LONGEST / 2);
  const result = rotations.slice();
  let sign = 1;
  for (let at = 4; at < rotations.length; at += 4) {
    let product = 0;
    for (let k = at; k < at + 4; k++) product += rotations[k] * rotations[k - 4];
    if (product < 0) sign = -sign;
    if (sign * rotations[at + 3] < least) sign = -sign;
    for (let k = at; k < at + 4; k++) result[k] = sign * rotations[k];
  }
  return result;
}
