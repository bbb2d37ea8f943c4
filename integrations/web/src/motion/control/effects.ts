/** The control energy of a whole motion, as in `ha2g_jax/motion/control/effects.py`. */

import type { Skeleton } from "../../description.js";
import type { Numbers } from "../rotations.js";
import { parts, restPose } from "./parts.js";
import { scaleAboutMeans } from "./scaling.js";

export const POSTURE_SECONDS = 4; // window of the slow mean pose, which counts as posture and not as movement
const MOST = 2;
const MIN_LENGTH = 1e-6; // a mean shorter than this has no direction

/** Checks an energy. */
export function checkEnergy(amount: number): void {
  if (!(typeof amount === "number" && amount >= 0 && amount <= MOST)) {
    throw new Error(`the energy is ${amount}; expected a number from 0 to ${MOST}, 1 for the unchanged motion`);
  }
}

/**
 * Makes a motion livelier or calmer by scaling the movement about its slow mean pose, and so the speed.
 *
 * @param skeleton - skeleton of the directions.
 * @param directions - (T, bones, 3) unit vectors.
 * @param fps - frames per second.
 * @param amount - factor from 0, the slow mean pose over 4 seconds, to 2; 1 is the unchanged motion.
 * @returns (T, bones, 3) unit vectors.
 */
export function energy(skeleton: Skeleton, directions: Float32Array, fps: number, amount: number): Float32Array {
  checkEnergy(amount);
  if (amount === 1) return directions;
  const means = (rotation: Numbers) => slowMean(rotation, fps, POSTURE_SECONDS);
  return scaleAboutMeans(restPose(skeleton), directions, means, amount, parts(skeleton));
}

/** Returns the mean of the quaternions (T x 4) around each one under a Hann window of some seconds. */
function slowMean(rotation: Numbers, fps: number, seconds: number): Numbers {
  const width = seconds * fps;
  const reach = Math.ceil(width / 2) - 1;
  const hann = (offset: number) => Math.cos((Math.PI * offset) / width) ** 2;
  const weights = Float64Array.from({ length: 2 * reach + 1 }, (_, k) => hann(k - reach));
  const frames = rotation.length / 4;
  const means = new Float64Array(rotation.length);
  for (let frame = 0; frame < frames; frame++) {
    const mean = means.subarray(4 * frame, 4 * frame + 4);
    for (let k = Math.max(frame - reach, 0); k <= Math.min(frame + reach, frames - 1); k++) {
      for (let axis = 0; axis < 4; axis++) mean[axis] += weights[k - frame + reach] * rotation[4 * k + axis];
    }
    const length = Math.hypot(...mean);
    if (length > MIN_LENGTH * reach) mean.forEach((value, axis) => (mean[axis] = value / length));
    else mean.set(rotation.subarray(4 * frame, 4 * frame + 4));
  }
  return means;
}
