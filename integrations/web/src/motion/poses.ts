/** Rotations of the joints of a rig over time, as renderers take them. */

import type { Skeleton } from "../description.js";
import type { Animation } from "./armature.js";
import type { Motion } from "./motion.js";
import { Transfer } from "./retargeting.js";
import { MIXAMO, VRM, type Rig } from "./rigs.js";
import type { Numbers } from "./rotations.js";
import { animate, Solver } from "./solver/solver.js";

const RIGS = { ha2g: undefined, mixamo: MIXAMO, vrm: VRM };

/** "ha2g" has the joints of the motion, "mixamo" the bones of Mixamo, "vrm" the humanoid bones of VRM 1.0. */
export type RigName = keyof typeof RIGS;

/** Rotations of the joints of a rig over time: y up, the figure faces +z, its left is at +x. */
export class Poses {
  constructor(
    /** Names of the joints, each after its parent. */
    readonly joints: string[],
    /** Frames per second; frame k shows the time k / fps. */
    readonly fps: number,
    /** (T, joints, 4) rotations x, y, z, w of each joint relative to its parent, the rest rotation included. */
    readonly rotations: Float32Array,
  ) {}

  /** Number of frames T. */
  get numFrames(): number {
    return this.rotations.length / (4 * this.joints.length);
  }

  /** Returns the rotations of one time, (joints, 4), between two frames interpolated; before and after, the end's. */
  at(seconds: number): Float32Array {
    const size = 4 * this.joints.length;
    const place = Math.min(Math.max(seconds * this.fps, 0), this.numFrames - 1);
    if (Number.isNaN(place)) throw new Error(`the time of the pose is ${seconds}; expected a number of seconds`);
    const first = Math.floor(place);
    const pose = this.rotations.slice(size * first, size * (first + 1));
    const next = this.rotations.subarray(size * Math.min(first + 1, this.numFrames - 1));
    // The signs are continuous over time. Between two frames the chord, made a unit quaternion, is near to the arc.
    for (let k = 0; k < size; k += 4) {
      let squared = 0;
      for (let part = k; part < k + 4; part++) {
        pose[part] += (place - first) * (next[part] - pose[part]);
        squared += pose[part] * pose[part];
      }
      for (let part = k; part < k + 4; part++) pose[part] /= Math.sqrt(squared);
    }
    return pose;
  }
}

/**
 * Converts a motion to rotations of the joints of a rig, as `ha2g export --rig` does.
 *
 * @param motion - motion of any skeleton.
 * @param rig - joints of the result.
 */
export function retarget(motion: Motion, rig: RigName): Poses {
  const target = rigOf(rig);
  const animation = animate(motion);
  return posesOf(target ? new Transfer(animation.armature, target).apply(animation) : animation);
}

/**
 * Converts a motion to rotations of the joints of its own armature, `ha2gArmature(motion.skeleton)`.
 *
 * @returns (T, joints, 4) quaternions x, y, z, w relative to the parents.
 */
export function localRotations(motion: Motion): Float32Array {
  return retarget(motion, "ha2g").rotations;
}

/** The conversion of `retarget` for frames that arrive one after the other; a frame does not depend on later ones. */
export class LivePoses {
  private readonly solver: Solver;
  private readonly transfer?: Transfer;
  private last?: Numbers[];

  /**
   * Starts before the first frame.
   *
   * @param skeleton - skeleton of the direction vectors.
   * @param fps - frames per second, 0.1 to 1000.
   * @param rig - joints of the result.
   */
  constructor(skeleton: Skeleton, fps: number, rig: RigName) {
    const target = rigOf(rig);
    this.solver = new Solver(skeleton, fps);
    if (target) this.transfer = new Transfer(this.solver.armature, target);
  }

  /** Converts the next frames, (n, bones, 3) unit vectors, at least one. */
  animate(directions: Float32Array): Poses {
    const own = this.solver.animate(directions);
    const animation = this.transfer ? this.transfer.apply(own, this.last) : own;
    this.last = animation.rotations.map((joint) => joint.slice(-4));
    return posesOf(animation);
  }
}

function rigOf(name: RigName): Rig | undefined {
  if (!Object.hasOwn(RIGS, name)) throw new Error(`no rig "${name}"; expected ${Object.keys(RIGS).join(", ")}`);
  return RIGS[name];
}

function posesOf({ armature, rotations, fps }: Animation): Poses {
  const count = armature.joints.length;
  const values = new Float32Array(count * rotations[0].length);
  rotations.forEach((joint, index) => {
    for (let k = 0; k < joint.length; k++) values[4 * (count * (k >> 2) + index) + (k & 3)] = joint[k];
  });
  return new Poses(armature.joints, fps, values);
}
