/** The control energy of a motion. */

import { energy } from "./control/effects.js";
import { Motion } from "./motion.js";

/**
 * Makes a motion livelier or calmer by scaling the movement about its slow mean pose, as `energy` of `generate` does.
 *
 * @param motion - motion whose energy is 1.
 * @param amount - factor from 0, the slow mean pose over 4 seconds, to 2; 1 is the unchanged motion.
 */
export function applyEnergy(motion: Motion, amount: number): Motion {
  const directions = energy(motion.skeleton, motion.directions, motion.fps, amount);
  if (directions === motion.directions) return motion;
  return new Motion(motion.skeleton, directions, motion.fps, { ...motion.meta, controls: { energy: amount } });
}
