/**
 * The controls energy and mute of a motion that goes on, as in `ha2g_jax/motion/control/effects.py`: each frame is
 * changed when it comes, without those after it.
 */

import type { Skeleton } from "../../description.js";
import { minimumJerk } from "../minimum-jerk.js";
import type { Numbers } from "../rotations.js";
import { POSTURE_SECONDS } from "./effects.js";
import { rotationsFrom } from "./local-rotations.js";
import { armParts, type Part, parts, restPose, SIDES } from "./parts.js";
import { scaleAbout, scaleAboutMeans } from "./scaling.js";

export const EASE_SECONDS = 0.5;

/** Returns an object of the same class with the same values. */
export function copyOf<T extends object>(value: T): T {
  return Object.assign(Object.create(Object.getPrototypeOf(value)), value);
}

/** Values (n,), `values`, that go to new ones within half a second, along a minimum-jerk curve. */
export class Ramp {
  private target: Numbers;
  private start: Numbers;
  values: Numbers;
  private readonly frames: number;
  private frame = 0;

  /**
   * @param values - (n,) values at the start.
   * @param fps - frames per second.
   */
  constructor(values: ArrayLike<number>, fps: number) {
    this.target = this.start = this.values = Float64Array.from(values);
    this.frames = Math.ceil(EASE_SECONDS * fps);
  }

  /**
   * Returns the values (n,) some frames later.
   *
   * @param target - (n,) values to go to; where they are new, the way begins at the present values.
   * @param frames - number of frames.
   */
  step(target: ArrayLike<number>, frames = 1): Numbers {
    if (this.target.some((value, k) => value !== target[k])) {
      this.target = Float64Array.from(target);
      this.start = this.values;
      this.frame = 0;
    }
    this.frame = Math.min(this.frame + frames, this.frames);
    const weight = minimumJerk(this.frame / this.frames);
    this.values = this.start.map((value, k) => value + weight * (this.target[k] - value));
    return this.values;
  }
}

/**
 * Energy and a mute of a motion that goes on. Energy scales the movement about the mean of the poses so far, an
 * exponential mean with a time constant of two seconds. Changes are eased over half a second.
 */
export class RunningControls {
  private ramp: Ramp;
  private readonly leastWeight: number;
  private readonly rest: Numbers;
  private readonly parts: Part[];
  private readonly arms: Part[][];
  private sum: Numbers;
  private numFrames = 0;

  /**
   * @param skeleton - skeleton of the motion.
   * @param fps - frames per second.
   * @param energy - energy of the first frame.
   */
  constructor(skeleton: Skeleton, fps: number, energy: number) {
    this.ramp = new Ramp([energy, 1], fps);
    this.leastWeight = 1 / ((POSTURE_SECONDS / 2) * fps);
    this.rest = restPose(skeleton);
    this.parts = parts(skeleton);
    this.arms = SIDES.map((side) => armParts(skeleton, side));
    this.sum = new Float64Array(this.rest.length);
  }

  /** Returns controls that go on from here on their own. */
  copy(): RunningControls {
    const copy = copyOf(this);
    [copy.ramp, copy.sum] = [copyOf(this.ramp), this.sum.slice()];
    return copy;
  }

  /** Weight of the motion of the arms in the last frame, 0 where they rest. */
  get arm(): number {
    return this.ramp.values[1];
  }

  /**
   * Applies the controls to the next frames.
   *
   * @param directions - (n, bones, 3) unit vectors, the frames after those of the last call.
   * @param energy - factor of the movement, 0 to 2.
   * @param muted - whether both arms rest.
   * @returns (n, bones, 3) unit vectors; the same values where the controls are neutral.
   */
  apply(directions: Float32Array, energy: number, muted: boolean): Float32Array {
    const size = this.rest.length;
    const result = new Float32Array(directions.length);
    for (let at = 0; at < directions.length; at += size) {
      const [amount, weight] = this.ramp.step([energy, muted ? 0 : 1]);
      result.set(this.frame(directions.subarray(at, at + size), amount, weight), at);
    }
    return result;
  }

  /** Returns one frame (bones, 3) after the controls. */
  private frame(pose: Float32Array, energy: number, weight: number): Float32Array {
    const posture = this.posture(pose);
    let frame = pose;
    if (energy !== 1) {
      const means = rotationsFrom(this.rest, posture, this.parts);
      const nearer = (rotation: Numbers, key: string) => {
        // Of the two quaternions of a rotation, the nearer one; a motion of two frames continues its signs by time.
        const mean = means.get(key)!;
        const product = mean.reduce((sum, value, k) => sum + value * rotation[k], 0);
        return product < 0 ? mean.map((value) => -value) : mean;
      };
      frame = scaleAboutMeans(this.rest, frame, nearer, energy, this.parts);
    }
    if (weight < 1) for (const arm of this.arms) frame = scaleAbout(this.rest, frame, weight, arm);
    return frame;
  }

  /** Adds a pose (bones, 3) to the mean, and returns the mean. */
  private posture(pose: Float32Array): Numbers {
    this.numFrames++;
    const weight = Math.max(1 / this.numFrames, this.leastWeight);
    const posture = new Float64Array(pose.length);
    for (let at = 0; at < pose.length; at += 3) {
      for (let k = at; k < at + 3; k++) this.sum[k] += weight * (pose[k] - this.sum[k]);
      const length = Math.hypot(this.sum[at], this.sum[at + 1], this.sum[at + 2]);
      for (let k = at; k < at + 3; k++) posture[k] = length > 1e-6 ? this.sum[k] / length : pose[k];
    }
    return posture;
  }
}
