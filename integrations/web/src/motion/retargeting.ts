/** Transfer of an animation of the "ha2g" armature to another rig. */

import { world, type Animation, type Armature } from "./armature.js";
import type { Rig, RigJoint } from "./rigs.js";
import { between, conjugate, continuous, IDENTITY, multiply, norms, rotate, slerp, tile, unit } from "./rotations.js";
import type { Numbers } from "./rotations.js";

/** Joints whose rotation another joint has, where the skeleton has a joint of that name for another purpose. */
const OTHER_NAMES: Record<string, string> = { head: "nose_0" };

/** Rest pose of a rig. */
interface RestPose {
  /** (3,) positions of the joints in metres. */
  places: Numbers[];
  /** (4,) rotations of the joints from the T-pose. */
  fromTPose: Numbers[];
}

/**
 * The transfer from the "ha2g" armature to a rig.
 *
 * Joints that carry a "ha2g" joint take its rotation in the world. Bones between joints that have the places of "ha2g"
 * joints point in the same directions as there. The joints of the spine divide the rotation of the chest. Hips and legs
 * stay in the rest pose and stand on the ground, y = 0.
 */
export class Transfer {
  /** Armature of the rig. */
  readonly armature: Armature;
  /** (3,) position of its root at rest, in metres. */
  private readonly start: Numbers;
  /** Joint of the "ha2g" armature that each joint carries, -1 for none. */
  private readonly sources: number[];
  /** Joint of the "ha2g" armature from whose rotation the fraction of each joint is counted, -1 for no rotation. */
  private readonly above: number[] = [];
  /** (4,) orientation of each joint relative to that of the joint that it carries. */
  private readonly fromSource: Numbers[];

  /**
   * Prepares the transfer.
   *
   * @param from - "ha2g" armature of a skeleton.
   * @param rig - any other rig.
   */
  constructor(
    from: Armature,
    private readonly rig: Rig,
  ) {
    const { places, fromTPose } = restPose(from, rig);
    this.start = places[0];
    this.armature = armatureOf(rig, places);
    this.sources = rig.joints.map(({ carries }) => sourceOf(from, carries));
    rig.joints.forEach(({ parent }) => {
      const isWhole = parent >= 0 && rig.joints[parent].weight === 1 && this.sources[parent] >= 0;
      this.above.push(parent < 0 ? -1 : isWhole ? this.sources[parent] : this.above[parent]);
    });
    this.fromSource = rig.joints.map(({ rest }, joint) => multiply(conjugate(fromTPose[joint]), rest));
  }

  /**
   * Transfers an animation.
   *
   * @param animation - animation of the armature that the transfer was prepared for.
   * @param before - (4,) rotation of each joint in the frame before, whose signs the quaternions continue.
   * @returns animation of `armature`.
   */
  apply(animation: Animation, before?: Numbers[]): Animation {
    const { rotated } = world(animation.armature, animation.rotations);
    const frames = animation.rotations[0].length / 4;
    const turned: Numbers[] = [];
    const rotations = this.rig.joints.map(({ parent, weight }, joint) => {
      const source = this.sources[joint];
      if (source < 0) {
        const still = tile(this.armature.rest[joint], frames);
        turned.push(parent < 0 ? still : multiply(turned[parent], still));
        return still;
      }
      const whole = rotated[source];
      const part = weight < 1 ? slerp(rotated[this.above[joint]] ?? tile(IDENTITY, frames), whole, weight) : whole;
      turned.push(multiply(part, this.fromSource[joint]));
      return parent < 0 ? turned[joint] : multiply(conjugate(turned[parent]), turned[joint]);
    });
    const signed = rotations.map((rows, joint) => continuous(unit(rows, 4), before?.[joint]));
    return { ...animation, armature: this.armature, rotations: signed, start: this.start };
  }
}

function restPose(from: Armature, rig: Rig): RestPose {
  const straight = tPose(from, rig);
  const pose: RestPose = { places: [], fromTPose: [] };
  rig.joints.forEach((joint, index) => {
    const above = pose.fromTPose[joint.parent] ?? IDENTITY;
    pose.fromTPose.push(turnOf(joint, index, above, rig, straight));
    const bone = rotate(above, minus(straight[index], straight[joint.parent] ?? new Float64Array(3)));
    pose.places.push(joint.parent < 0 ? straight[index] : plus(pose.places[joint.parent], bone));
  });
  return pose;
}

/** Returns the rotation (4) of a joint from the T-pose to the rest pose; `above` is that of its parent. */
function turnOf(joint: RigJoint, index: number, above: Numbers, rig: Rig, straight: Numbers[]): Numbers {
  if (joint.tPose) return multiply(joint.rest, conjugate(joint.tPose));
  const child = rig.joints.findIndex(({ parent }) => parent === index);
  if (!joint.direction || child < 0) return above;
  const bone = rotate(above, minus(straight[child], straight[index]));
  return norms(bone, 3)[0] > 0 ? multiply(between(bone, joint.direction), above) : above;
}

/** Returns (3,) positions of the rig's joints in the T-pose, with the motion's lengths where it has the joints. */
function tPose(from: Armature, rig: Rig): Numbers[] {
  const { positions } = world(from, from.rest);
  const straight: Numbers[] = [];
  let shift: Numbers | undefined;
  for (const { parent, offset, place } of rig.joints) {
    const own = plus(straight[parent] ?? new Float64Array(3), offset);
    const ours = positions[from.joints.indexOf(place ?? "")];
    if (ours) shift ??= minus(own, ours);
    straight.push(ours && shift ? plus(ours, shift) : own);
  }
  return straight;
}

/** Returns the armature of a rig from the positions (3) of its joints at rest. */
function armatureOf(rig: Rig, places: Numbers[]): Armature {
  const parents = rig.joints.map(({ parent }) => parent);
  const backs = parents.map((parent) => (parent < 0 ? IDENTITY : conjugate(rig.joints[parent].rest)));
  const offset = (parent: number, joint: number) =>
    parent < 0 ? new Float64Array(3) : rotate(backs[joint], minus(places[joint], places[parent]));
  return {
    name: rig.name,
    joints: rig.joints.map(({ name }) => name),
    parents,
    offsets: parents.map(offset),
    rest: rig.joints.map(({ rest }, joint) => multiply(backs[joint], rest)),
  };
}

/** Returns the index of the joint that rotates as the "ha2g" joint `name`, -1 without such a joint. */
function sourceOf(armature: Armature, name: string | null): number {
  const other = OTHER_NAMES[name ?? ""];
  return armature.joints.indexOf(other !== undefined && armature.joints.includes(other) ? other : (name ?? ""));
}

function plus(a: Numbers, b: Numbers): Numbers {
  return a.map((value, axis) => value + b[axis]);
}

function minus(a: Numbers, b: Numbers): Numbers {
  return a.map((value, axis) => value - b[axis]);
}
