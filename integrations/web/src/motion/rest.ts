/** Rest pose of a skeleton, a T-pose, in the axes of exported files: y up, facing +z, the person's left at +x. */

import * as tedExpressive from "../../../../ha2g_jax/assets/skeletons/ted_expressive.json";
import * as tedGesture from "../../../../ha2g_jax/assets/skeletons/ted_gesture.json";
import type { Skeleton } from "../description.js";
import { cross, dot, row, unit, type Numbers } from "./rotations.js";

export const UP: Numbers = Float64Array.of(0, 1, 0);
export const LEFT: Numbers = Float64Array.of(1, 0, 0);
export const FOUR_FINGERS = ["index", "middle", "ring", "pinky"];

/** Statistics of the data that define the rest pose; those of a model's own data are others. */
const MEANS: Record<string, { mean_dir_vec: number[]; mean_pose: number[] }> = {
  ted_expressive: tedExpressive,
  ted_gesture: tedGesture,
};

/** What `restDirections` returned: frames that arrive one by one need it again and again. */
const RESTS = new WeakMap<Skeleton, Numbers>();

/**
 * Returns (3,) signs that convert vectors from the skeleton's axes to those of exported files, and back.
 *
 * y down becomes y up. In TED-Expressive the person's left is at +x and the person faces -z; in TED-Gesture the left is
 * at -x and the person faces +z.
 */
export function exportAxes(skeleton: Skeleton): Numbers {
  const [left, right] = ["left", "right"].map(
    (side) => meansOf(skeleton).mean_pose[3 * skeleton.joints.indexOf(`${side}_shoulder`)],
  );
  return left > right ? Float64Array.of(1, -1, -1) : Float64Array.of(-1, -1, 1);
}

/**
 * Returns (bones x 3) unit vectors of the bones in the T-pose.
 *
 * Trunk, arms and fingers are straight. Collarbones and face are those of the mean pose of the data, made symmetric,
 * and so are the bones within the hand, rotated so that the bone of the middle finger lies along the arm and the palm
 * is level.
 *
 * @returns an array that is the same for each call with a skeleton, and not to be changed.
 */
export function restDirections(skeleton: Skeleton): Numbers {
  const known = RESTS.get(skeleton);
  if (known) return known;
  const rest = symmetricMean(skeleton);
  const hand = skeleton.joints.includes("left_index_1") ? restHand(skeleton, rest) : {};
  skeleton.bones.forEach(([, child], bone) => {
    const name = skeleton.joints[child];
    const part = name.replace(/^(left|right)_/, "");
    const straight = name === "neck" ? UP : ["elbow", "wrist"].includes(part) ? LEFT : hand[part];
    if (straight) rest.set(name.startsWith("right_") ? [-straight[0], straight[1], straight[2]] : straight, 3 * bone);
  });
  RESTS.set(skeleton, rest);
  return rest;
}

function meansOf(skeleton: Skeleton): { mean_dir_vec: number[]; mean_pose: number[] } {
  if (!Object.hasOwn(MEANS, skeleton.name)) {
    throw new Error(`no rest pose of the skeleton ${skeleton.name}; expected ${Object.keys(MEANS).join(" or ")}`);
  }
  return MEANS[skeleton.name];
}

/** Returns (bones x 3) unit vectors of the mean pose, made symmetric, in the axes of exported files. */
function symmetricMean(skeleton: Skeleton): Numbers {
  const axes = exportAxes(skeleton);
  const mean = Float64Array.from(meansOf(skeleton).mean_dir_vec, Math.fround);
  const children = skeleton.bones.map(([, child]) => skeleton.joints[child]);
  const sum = mean.slice();
  children.forEach((child, bone) => {
    const swapped = child.replace(/^(left|right)_/, (side) => (side === "left_" ? "right_" : "left_"));
    const [x, y, z] = row(mean, children.indexOf(swapped), 3);
    sum.set([sum[3 * bone] - x, sum[3 * bone + 1] + y, sum[3 * bone + 2] + z], 3 * bone);
  });
  return unit(sum, 3).map((value, k) => value * axes[k % 3]);
}

/** Returns unit vectors of the bones of a left hand along +x, palm down, by the joint at the end without its side. */
function restHand(skeleton: Skeleton, mean: Numbers): Record<string, Numbers> {
  const ends = skeleton.bones.map(([, child]) => skeleton.joints[child]);
  const fan = (finger: string) => row(mean, ends.indexOf(`left_${finger}_1`), 3);
  const along = fan("middle");
  const spread = fan("index").map((value, axis) => value - fan("pinky")[axis]);
  const back = unit(cross(spread, along), 3);
  const axes = [along, back, cross(along, back)];
  const directions: Record<string, Numbers> = {};
  for (const finger of [...FOUR_FINGERS, "thumb"]) {
    const first = unit(Float64Array.from(axes, (axis) => dot(axis, fan(finger))[0]), 3);
    directions[`${finger}_1`] = first;
    for (const part of [2, 3]) directions[`${finger}_${part}`] = finger === "thumb" ? first : LEFT;
  }
  return directions;
}
