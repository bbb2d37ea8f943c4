/**
 * Division of a skeleton into parts: trunk, head, and upper arm, forearm, hand and finger bones of each arm, as in
 * `ha2g_jax/motion/control/parts.py`.
 */

import type { Skeleton } from "../../description.js";
import { outward } from "../motion.js";
import { about, cross, dot, type Numbers, radians, rotate, unit } from "../rotations.js";

export const SIDES = ["left", "right"] as const;
const RESTING_FOREARM = radians(65); // from straight down

/** Bones that rotate together. */
export interface Part {
  kind: "trunk" | "head" | "upper arm" | "forearm" | "hand" | "finger";
  /** "" on the midline. */
  side: "left" | "right" | "";
  /** Numbers of the bones; more than one for the head and for the bones that leave the wrist. */
  bones: number[];
  /** Number of the bone that the part rotates with, -1 for a part that rotates with none. */
  parent: number;
}

/** Divides all bones of a skeleton into parts, each after the one it is attached to; upper arms are attached to none. */
export function parts(skeleton: Skeleton): Part[] {
  const arms = SIDES.flatMap((side) => armParts(skeleton, side));
  const shoulders = SIDES.flatMap((side) => path(skeleton, joint(skeleton, `${side}_shoulder`)));
  const trunk = [...new Set(shoulders)].sort((a, b) => a - b);
  const taken = new Set([...trunk, ...arms.flatMap((part) => part.bones)]);
  const rest = [...skeleton.bones.keys()].filter((bone) => !taken.has(bone));
  const head: Part[] = rest.length ? [{ kind: "head", side: "", bones: rest, parent: -1 }] : [];
  return [...trunk.map((bone): Part => ({ kind: "trunk", side: "", bones: [bone], parent: -1 })), ...head, ...arms];
}

/** Returns the parts of an arm: upper arm, forearm, hand and fingers. */
export function armParts(skeleton: Skeleton, side: "left" | "right"): Part[] {
  const { bones } = skeleton;
  const [upper, fore] = ["elbow", "wrist"].map((name) => ending(skeleton, joint(skeleton, `${side}_${name}`)));
  const wrist = joint(skeleton, `${side}_wrist`);
  const hand = bones.flatMap(([start], bone) => (start === wrist ? [bone] : []));
  const depths = bones.map(([, child]) => path(skeleton, child).length);
  const fingers = [...bones.keys()]
    .filter((bone) => path(skeleton, bones[bone][0]).some((before) => hand.includes(before)))
    .sort((a, b) => depths[a] - depths[b]);
  return [
    { kind: "upper arm", side, bones: [upper], parent: -1 },
    { kind: "forearm", side, bones: [fore], parent: upper },
    ...(hand.length ? [{ kind: "hand", side, bones: hand, parent: fore } as Part] : []),
    ...fingers.map((bone): Part => ({ kind: "finger", side, bones: [bone], parent: ending(skeleton, bones[bone][0]) })),
  ];
}

/**
 * Returns the rest pose of a skeleton, (bones, 3) unit vectors: the mean pose, made symmetric, with forearms and hands
 * lowered until the forearms are at 65 degrees from straight down.
 */
export function restPose(skeleton: Skeleton): Numbers {
  const mean = skeleton.mean_directions.map((vector) => vector.map(Math.fround));
  const mirrored = skeleton.bones.map(([, child]) => {
    const other = { left: "right", right: "left" } as Record<string, string>;
    const name = skeleton.joints[child].split("_").map((part) => other[part] ?? part).join("_");
    const [x, y, z] = mean[ending(skeleton, joint(skeleton, name))];
    return [-x, y, z];
  });
  const pose = unit(Float64Array.from(mean.flatMap((vector, bone) => vector.map((v, k) => v + mirrored[bone][k]))), 3);
  for (const side of SIDES) {
    const lowered = armParts(skeleton, side).filter((part) => part.kind !== "upper arm").flatMap((part) => part.bones);
    const forearm = pose.slice(3 * lowered[0], 3 * lowered[0] + 3);
    const down = Float64Array.of(0, 1, 0);
    const axis = cross(forearm, down);
    const angle = Math.max(Math.atan2(Math.hypot(...axis), dot(forearm, down)[0]) - RESTING_FOREARM, 0);
    const rotation = about(unit(axis, 3), Float64Array.of(angle));
    for (const bone of lowered) pose.set(rotate(rotation, pose.slice(3 * bone, 3 * bone + 3)), 3 * bone);
  }
  return pose.map(Math.fround);
}

function joint(skeleton: Skeleton, name: string): number {
  const found = skeleton.joints.indexOf(name);
  if (found < 0) throw new Error(`the skeleton ${skeleton.name} has no joint ${name}`);
  return found;
}

/** Returns the bone that ends in a joint. */
function ending(skeleton: Skeleton, child: number): number {
  return skeleton.bones.findIndex((bone) => bone[1] === child);
}

/** Returns the bones from the root to a joint. */
function path(skeleton: Skeleton, child: number): number[] {
  const paths = new Map<number, number[]>([[0, []]]);
  for (const [bone, parent, end] of outward(skeleton)) paths.set(end, [...paths.get(parent)!, bone]);
  return paths.get(child)!;
}
