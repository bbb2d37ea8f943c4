/**
 * Motion for avatars of TalkingHead (met4citizen/TalkingHead), whose bones have the names and axes of Mixamo's.
 *
 * ```ts
 * const poses = retarget(motion, "mixamo");
 * const head = new TalkingHead(node, { update: () => poseTalkingHead(head, poses.at(seconds())) });
 * ```
 */

import { MIXAMO } from "../motion/rigs.js";

/** Quaternion x, y, z, w. */
export type Quaternion = [number, number, number, number];

/** The parts of TalkingHead and of three.js that are used. */
export interface TalkingHeadLike {
  armature: { getObjectByName(name: string): Rotatable | undefined };
}

interface Rotatable {
  quaternion: { set(x: number, y: number, z: number, w: number): unknown };
}

/** Bones that a motion moves; hips and legs keep the pose of TalkingHead. */
const UPPER_BODY = /^(Spine|Neck|Head$|(Left|Right)(Shoulder|Arm|ForeArm|Hand))/;

const BONES = MIXAMO.joints.map(({ name }) => name.replace("mixamorig:", ""));

/**
 * Returns the rotation of each bone of the upper body relative to its parent, by the name of the bone, such as LeftArm.
 *
 * @param pose - (joints, 4) rotations of the rig "mixamo": `retarget(motion, "mixamo").at(seconds)`.
 */
export function talkingHeadBones(pose: ArrayLike<number>): Map<string, Quaternion> {
  if (pose.length !== 4 * BONES.length) {
    throw new Error(`the pose has ${pose.length} numbers; expected ${4 * BONES.length}, those of the rig mixamo`);
  }
  const bones = new Map<string, Quaternion>();
  BONES.forEach((name, k) => {
    if (UPPER_BODY.test(name)) bones.set(name, [pose[4 * k], pose[4 * k + 1], pose[4 * k + 2], pose[4 * k + 3]]);
  });
  return bones;
}

/**
 * Rotates the bones of the upper body of an avatar; bones that it lacks are left out.
 *
 * Call it in the option `update` of TalkingHead, which is called in each frame after TalkingHead's own poses.
 *
 * @param head - a TalkingHead with an avatar.
 * @param pose - (joints, 4) rotations of the rig "mixamo".
 */
export function poseTalkingHead(head: TalkingHeadLike, pose: ArrayLike<number>): void {
  talkingHeadBones(pose).forEach((rotation, name) => {
    head.armature.getObjectByName(name)?.quaternion.set(...rotation);
  });
}
