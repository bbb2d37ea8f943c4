/** Conversion of direction vectors to joint rotations of the armature of a skeleton. */

import type { Skeleton } from "../../description.js";
import { ha2gArmature, type Animation, type Armature } from "../armature.js";
import { checkFps, type Motion } from "../motion.js";
import { exportAxes } from "../rest.js";
import { continuous, unit, type Numbers } from "../rotations.js";
import { pointed, solve } from "./frames.js";
import { clamp, withoutJumps } from "./limits.js";
import { FrameByFrame, WholeMotion } from "./twist.js";

/**
 * Converts a motion to rotations of the joints of the "ha2g" armature, as Python's `solver.animate`.
 *
 * Each bone has exactly its direction. Its twist is estimated from the bones around it, within the range of a human
 * joint; where these do not show it, it is held over time.
 *
 * @returns animation whose root does not move; the signs of its quaternions are continuous over time.
 */
export function animate(motion: Motion): Animation {
  const { skeleton, fps } = motion;
  const armature = ha2gArmature(skeleton);
  const directions = byBone(skeleton, motion.directions);
  const free = solve(skeleton, armature, directions, new WholeMotion(fps));
  const kept = pointed(skeleton, armature, directions, withoutJumps(free, clamp(armature.joints, free)));
  const rotations = kept.map((joint) => continuous(unit(joint, 4)));
  return { armature, rotations, start: new Float64Array(3), fps };
}

/**
 * The conversion of `animate` for frames that arrive one after the other; a frame does not depend on later ones.
 *
 * A frame is as it is as the last frame of a motion that ends with it.
 */
export class Solver {
  /** The "ha2g" armature of the skeleton. */
  readonly armature: Armature;
  private readonly twists: FrameByFrame;
  /** (4,) rotations of each joint in the last frame: free, within the limits, and returned. */
  private last?: { free: Numbers[]; kept: Numbers[]; returned: Numbers[] };

  /**
   * Starts before the first frame.
   *
   * @param skeleton - skeleton of the direction vectors.
   * @param fps - frames per second, 0.1 to 1000.
   */
  constructor(
    private readonly skeleton: Skeleton,
    private readonly fps: number,
  ) {
    checkFps(fps);
    this.armature = ha2gArmature(skeleton);
    this.twists = new FrameByFrame(fps);
  }

  /**
   * Converts the next frames.
   *
   * @param directions - (n, bones, 3) unit vectors, at least one frame.
   * @returns animation of these frames; the signs of its quaternions continue those of the frames before.
   */
  animate(directions: Float32Array): Animation {
    const { armature, last } = this;
    const along = byBone(this.skeleton, directions);
    const free = solve(this.skeleton, armature, along, this.twists);
    const clamped = clamp(armature.joints, free);
    const kept = last
      ? withoutJumps(joined(last.free, free), joined(last.kept, clamped)).map((joint) => joint.slice(4))
      : withoutJumps(free, clamped);
    const exact = pointed(this.skeleton, armature, along, kept);
    const returned = exact.map((joint, index) => continuous(unit(joint, 4), last?.returned[index]));
    const end = (joints: Numbers[]) => joints.map((joint) => joint.slice(-4));
    this.last = { free: end(free), kept: end(kept), returned: end(returned) };
    return { armature, rotations: returned, start: new Float64Array(3), fps: this.fps };
  }
}

/** Returns the unit vectors (T x 3) of each bone in the axes of exported files, of directions (T, bones, 3). */
function byBone(skeleton: Skeleton, directions: Float32Array): Numbers[] {
  const axes = exportAxes(skeleton);
  const count = skeleton.bones.length;
  const frames = directions.length / (3 * count);
  if (!frames || !Number.isInteger(frames) || !directions.every(Number.isFinite)) {
    throw new Error(`the ${directions.length} numbers are not frames of ${count} finite directions`);
  }
  return skeleton.bones.map((_, bone) => {
    const vectors = new Float64Array(3 * frames);
    for (let k = 0; k < vectors.length; k++) {
      vectors[k] = directions[3 * (count * Math.floor(k / 3) + bone) + (k % 3)] * axes[k % 3];
    }
    return unit(vectors, 3);
  });
}

/** Returns the rotations of each joint in some frames, and then in others. */
export function joined(first: Numbers[], second: Numbers[]): Numbers[] {
  return first.map((joint, index) => Float64Array.from([...joint, ...second[index]]));
}
