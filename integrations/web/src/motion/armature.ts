/**
 * Armatures (trees of joints with a rest pose), their animations, and the armature of a skeleton.
 *
 * Axes: metres, y up, the person faces +z, the person's left is at +x. Rotations are flat arrays, see rotations.ts.
 */

import type { Skeleton } from "../description.js";
import { IDENTITY, multiply, rotate, tile, type Numbers } from "./rotations.js";
import { restDirections } from "./rest.js";

/** A tree of J joints, each with an origin and axes of its own. */
export interface Armature {
  /** Name of the rig, such as "ha2g". */
  name: string;
  /** Names of the joints, each after its parent; joint 0 is the root. */
  joints: string[];
  /** Index of each joint's parent, -1 for the root. */
  parents: number[];
  /** (3,) metres of each joint from its parent's origin, in the parent's axes at rest. */
  offsets: Numbers[];
  /** (4,) rotation of each joint relative to its parent in the rest pose. */
  rest: Numbers[];
}

/** Rotations of the joints of an armature over time; the root does not move. */
export interface Animation {
  armature: Armature;
  /** (T x 4) rotations of each joint relative to its parent; at rest they are `armature.rest`. */
  rotations: Numbers[];
  /** (3,) position of the root in metres. */
  start: Numbers;
  /** Frames per second. */
  fps: number;
}

/**
 * Joints that rotate one of several bones, by the joint at the end of the bone; the names of others end in 0, as in
 * left_index_0.
 */
const CARRIERS: Record<string, string> = {
  left_shoulder: "left_clavicle",
  right_shoulder: "right_clavicle",
  nose: "head",
};

/**
 * Builds the armature of a skeleton in a T-pose: palms down, fingers along the arm, head up.
 *
 * At rest all rotations are zero. All joints of the skeleton are joints of the armature. Where several bones leave one
 * joint, each bone has a further joint there, with offset 0, that rotates it: left_clavicle; head, from the neck to the
 * nose (nose_0 in TED-Gesture); left_eye_0; left_index_0 and so on.
 *
 * @param skeleton - names of the joints and bone lengths.
 */
export function ha2gArmature(skeleton: Skeleton): Armature {
  const directions = restDirections(skeleton);
  const armature: Armature = { name: "ha2g", joints: [], parents: [], offsets: [], rest: [] };
  const add = (name: string, parent: number, offset: Numbers) => {
    armature.parents.push(parent);
    armature.offsets.push(offset);
    armature.rest.push(IDENTITY);
    return armature.joints.push(name) - 1;
  };
  const grow = (start: number, index: number) => {
    const count = skeleton.bones.filter(([parent]) => parent === start).length;
    skeleton.bones.forEach(([parent, child], bone) => {
      if (parent !== start) return;
      const name = skeleton.joints[child];
      const above = count > 1 ? add(carrier(skeleton, name), index, new Float64Array(3)) : index;
      const offset = directions.slice(3 * bone, 3 * bone + 3).map((value) => value * skeleton.lengths[bone]);
      grow(child, add(name, above, offset));
    });
  };
  grow(0, add(skeleton.joints[0], -1, new Float64Array(3)));
  return armature;
}

/** Returns the name of the joint of `ha2gArmature` that rotates each bone of a skeleton. */
export function carriers(skeleton: Skeleton): string[] {
  return skeleton.bones.map(([start, child]) => {
    const isOnly = skeleton.bones.filter(([parent]) => parent === start).length === 1;
    return isOnly ? skeleton.joints[start] : carrier(skeleton, skeleton.joints[child]);
  });
}

/**
 * Computes forward kinematics.
 *
 * @param armature - armature of J joints.
 * @param local - (T x 4) rotations of each joint relative to its parent.
 * @param start - (3,) position of the root in metres.
 * @returns (T x 4) rotations and (T x 3) positions of each joint in the world.
 */
export function world(
  armature: Armature,
  local: Numbers[],
  start: Numbers = new Float64Array(3),
): { rotated: Numbers[]; positions: Numbers[] } {
  const rotated: Numbers[] = [];
  const positions: Numbers[] = [];
  armature.parents.forEach((parent, joint) => {
    if (parent < 0) {
      rotated.push(local[joint]);
      positions.push(tile(start, local[joint].length / 4));
      return;
    }
    rotated.push(multiply(rotated[parent], local[joint]));
    const bone = rotate(rotated[parent], armature.offsets[joint]);
    positions.push(bone.map((value, k) => value + positions[parent][k]));
  });
  return { rotated, positions };
}

/** Returns the name of the joint that rotates the bone to `child`, one of several bones of a joint. */
function carrier(skeleton: Skeleton, child: string): string {
  const name = CARRIERS[child];
  return name !== undefined && !skeleton.joints.includes(name) ? name : `${child.replace(/_1$/, "")}_0`;
}
