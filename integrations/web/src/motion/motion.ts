/** Motion of a skeleton over time. */

import type { Skeleton } from "../description.js";

const MIN_NORM = 1e-8;
const MIN_FPS = 0.1; // of a file of motion, as in Python
const MAX_FPS = 1000;

/** Poses over time in metres, the root at the origin, y down; `meta` says where x points. */
export class Motion {
  readonly skeleton: Skeleton;
  /** Frames per second; frame k shows the time k / fps. */
  readonly fps: number;
  /** (T, bones, 3) unit vectors from the parent to the child of each bone. */
  readonly directions: Float32Array;
  /** JSON values that say how the motion was made; "skeleton" is the name of the skeleton. */
  readonly meta: Record<string, unknown>;

  /**
   * Builds a motion from direction vectors.
   *
   * @param skeleton - skeleton of the direction vectors.
   * @param directions - (T, bones, 3) vectors of any positive length; they are normalised.
   * @param fps - frames per second, 0.1 to 1000.
   * @param meta - further entries of `meta`.
   * @throws Error if the frame rate is out of range, or a vector has no direction.
   */
  constructor(skeleton: Skeleton, directions: Float32Array, fps: number, meta: Record<string, unknown> = {}) {
    if (!directions.length || directions.length % (3 * skeleton.bones.length)) {
      throw new Error(`${directions.length} numbers are not the directions of ${skeleton.bones.length} bones`);
    }
    checkFps(fps);
    const [left, right] = ["left", "right"].map((side) => {
      return skeleton.mean_pose[skeleton.joints.indexOf(`${side}_shoulder`)]?.[0] ?? 0;
    }) as [number, number];
    const axes = { units: "metres", x: `the person's ${left > right ? "left" : "right"}`, y: "down" };
    this.skeleton = skeleton;
    this.fps = fps;
    this.directions = normalized(skeleton, directions);
    this.meta = { skeleton: skeleton.name, axes, ...meta };
  }

  /** Number of frames T. */
  get numFrames(): number {
    return this.directions.length / (3 * this.skeleton.bones.length);
  }

  /** Computes the positions of the joints in metres, (T, joints, 3). */
  positions(): Float32Array {
    const { joints, lengths } = this.skeleton;
    const bones = outward(this.skeleton);
    const positions = new Float32Array(this.numFrames * joints.length * 3);
    for (let frame = 0; frame < this.numFrames; frame++) {
      const from = 3 * lengths.length * frame;
      const to = 3 * joints.length * frame;
      for (const [bone, parent, child] of bones) {
        for (let axis = 0; axis < 3; axis++) {
          const step = lengths[bone] * this.directions[from + 3 * bone + axis];
          positions[to + 3 * child + axis] = positions[to + 3 * parent + axis] + step;
        }
      }
    }
    return positions;
  }
}

/** Checks a frame rate. */
export function checkFps(fps: number): void {
  if (!(fps >= MIN_FPS && fps <= MAX_FPS)) {
    throw new Error(`the motion has ${fps} frames per second; expected ${MIN_FPS} to ${MAX_FPS}`);
  }
}

/** Returns number, parent and child of each bone, each after the bone that ends in its parent. */
export function outward(skeleton: Skeleton): [number, number, number][] {
  const pending = skeleton.bones.map(([parent, child], bone): [number, number, number] => [bone, parent, child]);
  const reached = new Set([0]);
  const ordered: [number, number, number][] = [];
  while (pending.length) {
    const next = pending.findIndex(([, parent]) => reached.has(parent));
    if (next < 0) throw new Error(`the skeleton ${skeleton.name} has bones that are not connected with its root`);
    const [bone] = pending.splice(next, 1) as [[number, number, number]];
    reached.add(bone[2]);
    ordered.push(bone);
  }
  return ordered;
}

/** Returns vectors (T, bones, 3) scaled to unit length. */
function normalized({ joints, bones }: Skeleton, vectors: Float32Array): Float32Array {
  const result = new Float32Array(vectors.length);
  for (let at = 0; at < vectors.length; at += 3) {
    const length = Math.hypot(vectors[at], vectors[at + 1], vectors[at + 2]);
    if (!(length >= MIN_NORM && length < Infinity)) {
      const [bone, frame] = [(at / 3) % bones.length, Math.floor(at / 3 / bones.length)];
      const where = `the bone to ${joints[bones[bone][1]]} in frame ${frame}`;
      throw new Error(`${where} has a direction of length ${length}; expected a finite one above 0`);
    }
    for (let axis = at; axis < at + 3; axis++) result[axis] = vectors[axis] / length;
  }
  return result;
}
