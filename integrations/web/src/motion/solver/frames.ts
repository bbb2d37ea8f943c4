/** Rotations of the joints of the armature of a skeleton that give each bone its direction. */

import type { Skeleton } from "../../description.js";
import { carriers, type Armature } from "../armature.js";
import { fit } from "../fitting.js";
import { LEFT, restDirections, UP } from "../rest.js";
import { between, conjugate, IDENTITY, multiply, rotate, tile, type Numbers } from "../rotations.js";
import { armFrames, type ByJoint } from "./arms.js";
import { applyTwist, observe, plus, swing, type Twists } from "./twist.js";

const FACE = ["nose", "head", "left_eye", "right_eye", "left_ear", "right_ear"];
/** Weight of facing ahead; a twist that is clearly visible has weight 1. */
const AHEAD = 2e-5;

/**
 * Computes rotations of the joints of an armature relative to their parents.
 *
 * The twist of trunk, head, arms, hands and knuckles is estimated from the bones around them; all other bones only
 * swing.
 *
 * @param skeleton - skeleton of the directions.
 * @param armature - `ha2gArmature` of the skeleton.
 * @param directions - (T x 3) unit vectors of each bone in the axes of the armature.
 * @param twists - estimates of the twists over time.
 * @returns (T x 4) rotations of each joint.
 */
export function solve(skeleton: Skeleton, armature: Armature, directions: Numbers[], twists: Twists): Numbers[] {
  const restVectors = restDirections(skeleton);
  const seen: ByJoint = {};
  const rest: ByJoint = {};
  skeleton.bones.forEach(([, child], bone) => {
    seen[skeleton.joints[child]] = directions[bone];
    rest[skeleton.joints[child]] = restVectors.slice(3 * bone, 3 * bone + 3);
  });
  const names = carriers(skeleton);
  const trunk = trunkFrames(seen, twists);
  const nose = skeleton.bones.findIndex(([, child]) => skeleton.joints[child] === "nose");
  const frames: ByJoint = { spine: trunk, [names[nose]]: headFrames(names[nose], seen, rest, trunk, twists) };
  for (const side of ["left", "right"]) Object.assign(frames, armFrames(side, seen, rest, trunk, twists));
  const still = tile(IDENTITY, directions[0].length / 3);
  const local: Numbers[] = [];
  const rotated: Numbers[] = [];
  armature.joints.forEach((name, joint) => {
    const above = rotated[armature.parents[joint]] ?? still;
    const back = conjugate(above);
    const bone = names.indexOf(name);
    if (name in frames) local.push(multiply(back, frames[name]));
    else if (bone < 0) local.push(still);
    else local.push(between(restVectors.slice(3 * bone, 3 * bone + 3), rotate(back, directions[bone])));
    rotated.push(multiply(above, local[joint]));
  });
  return local;
}

/**
 * Swings joints that were clamped so that each bone has its direction again; twists and hands stay as they are.
 *
 * @param skeleton - skeleton of the directions.
 * @param armature - `ha2gArmature` of the skeleton.
 * @param directions - (T x 3) unit vectors of each bone in the axes of the armature.
 * @param kept - (T x 4) rotations of each joint of `solve`, clamped.
 */
export function pointed(skeleton: Skeleton, armature: Armature, directions: Numbers[], kept: Numbers[]): Numbers[] {
  const rest = restDirections(skeleton);
  const names = carriers(skeleton);
  const still = tile(IDENTITY, directions[0].length / 3);
  const rotated: Numbers[] = [];
  return armature.joints.map((name, joint) => {
    const above = rotated[armature.parents[joint]] ?? still;
    const bone = names.indexOf(name);
    const own = multiply(above, kept[joint]);
    rotated.push(bone < 0 ? own : swing(own, rest.slice(3 * bone, 3 * bone + 3), directions[bone]));
    return multiply(conjugate(above), rotated[joint]);
  });
}

/** Computes rotations (T x 4) of the trunk: upright along the spine, facing as the shoulders do. */
function trunkFrames(seen: ByJoint, twists: Twists): Numbers {
  const frames = twists.transport("spine", tile(IDENTITY, seen.neck.length / 3), UP, seen.neck);
  const shoulders = seen.left_shoulder.map((value, k) => value - seen.right_shoulder[k]);
  const weight = Float64Array.from({ length: shoulders.length / 3 }, (_, k) => {
    const [x, y, z] = shoulders.subarray(3 * k, 3 * k + 3);
    return (x * x + y * y + z * z) / 4;
  });
  const ahead = observe(frames, UP, LEFT, tile(LEFT, weight.length), AHEAD);
  const seenTwist = plus(observe(frames, UP, LEFT, shoulders, weight), ahead);
  return applyTwist(frames, UP, twists.smooth("spine", seenTwist));
}

/** Computes rotations (T x 4) of the joint that rotates the head, with the twist of the face. */
function headFrames(joint: string, seen: ByJoint, rest: ByJoint, trunk: Numbers, twists: Twists): Numbers {
  const frames = twists.transport(joint, trunk, rest.nose, seen.nose);
  const face = FACE.filter((name) => name in rest);
  const { fitted, certainty } = fit(face.map((name) => seen[name]), face.map((name) => rest[name]));
  const weight = certainty.map((value) => value * value);
  const ahead = observe(frames, rest.nose, LEFT, rotate(trunk, LEFT), AHEAD);
  const seenTwist = plus(observe(frames, rest.nose, LEFT, rotate(fitted, LEFT), weight), ahead);
  return applyTwist(frames, rest.nose, twists.smooth(joint, seenTwist));
}
