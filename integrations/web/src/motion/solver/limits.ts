/** Limits of the joints to the range of a human body; the ranges and their sources are in joint_limits.json. */

import { joints, noise } from "../../../../../ha2g_jax/assets/joint_limits.json";
import { fromEuler, toEuler } from "../euler.js";
import { FOUR_FINGERS } from "../rest.js";
import {
  about,
  angleBetween,
  conjugate,
  dot,
  fromVector,
  IDENTITY,
  multiply,
  norms,
  slerp,
  toVector,
  twist,
  twistAngle,
  type Numbers,
} from "../rotations.js";

/** Lowest and highest value in radians by the name of an angle. */
type Limits = Record<string, [number, number]>;

/** Limits in degrees by the name of a joint without its side; one number is the limit of an angle from 0 on. */
const TABLE = joints as Record<string, Record<string, number | number[]>>;

/** Limits by the name of a joint, as far as they were asked for. */
const KNOWN = new Map<string, Limits | undefined>();

const DEGREE = Math.PI / 180;

/** Names of the two angles of the swing and of the twist, with their axes, for a left limb and for the head. */
const LIMB = { forward: [0, -1, 0], up: [0, 0, 1], twist: [1, 0, 0] };
const HEAD = { pitch: [1, 0, 0], roll: [0, 0, -1], yaw: [0, 1, 0] };

/** Beyond this twist the limited twist is reduced, to 0 at 180 degrees. */
const NEARLY_REVERSED = 150 * DEGREE;
/** Change from one frame to the next, between the ends of a range. */
const FASTEST = 80 * DEGREE;
/** Signs of a rotation in the mirror that exchanges left and right. */
const MIRROR = [1, -1, -1, 1];

/**
 * Clamps the rotations of all joints to their limits; rotations within them do not change.
 *
 * @param names - names of the joints.
 * @param local - (T x 4) rotations of each joint relative to its parent.
 */
export function clamp(names: string[], local: Numbers[]): Numbers[] {
  return names.map((joint, index) => clampJoint(joint, local[index]));
}

/**
 * Limits the speed of clamped rotations from one end of a range to the other to 80 degrees per frame.
 *
 * A joint outside of its range may be near to both ends and so be clamped to one in one frame and to the other in the
 * next. Where the joint itself is faster, so is the result.
 *
 * @param local - (T x 4) rotations of each joint before they were clamped.
 * @param clamped - (T x 4) rotations of each joint of `clamp`.
 */
export function withoutJumps(local: Numbers[], clamped: Numbers[]): Numbers[] {
  return clamped.map((kept, joint) => {
    if (kept.length < 8) return kept;
    const steps = (rows: Numbers) => angleBetween(rows.subarray(4), rows.subarray(0, -4));
    const most = steps(local[joint]).map((step) => Math.max(step, FASTEST));
    const slowed = kept.slice();
    steps(kept).forEach((found, first) => {
      if (found <= most[first]) return;
      for (let frame = first; frame < most.length; frame++) {
        const [last, next] = [0, 4].map((ahead) => slowed.slice(4 * frame + ahead, 4 * frame + ahead + 4));
        const step = angleBetween(next, last)[0];
        if (step <= most[frame]) break;
        slowed.set(slerp(last, next, most[frame] / step), 4 * frame + 4);
      }
    });
    return slowed;
  });
}

/** Returns the limits of a joint of the armature, undefined for a joint without limits. */
function limitsOf(joint: string): Limits | undefined {
  if (!KNOWN.has(joint)) KNOWN.set(joint, readLimits(joint));
  return KNOWN.get(joint);
}

function readLimits(joint: string): Limits | undefined {
  const name = joint.replace(/^(left|right)_/, "");
  const [finger, part] = name.split("_");
  // nose_0 rotates the head, where the skeleton has another joint of that name.
  const row = name === "nose_0" ? TABLE.head : TABLE[FOUR_FINGERS.includes(finger) ? `finger_${part}` : name];
  if (!row) return undefined;
  const range = (limit: number | number[]): [number, number] => {
    const [low, high] = [0, limit].flat().slice(-2);
    return [(low - noise) * DEGREE, (high + noise) * DEGREE];
  };
  return Object.fromEntries(Object.entries(row).map(([angle, limit]) => [angle, range(limit)]));
}

/** Clamps rotations (T x 4) of a joint. */
function clampJoint(joint: string, local: Numbers): Numbers {
  const limits = limitsOf(joint);
  if (!limits) return local;
  const names = "angle" in limits ? ["angle"] : Object.keys(axesOf(joint));
  const found = jointAngles(joint, local, limits);
  const clamped = local.slice();
  for (let k = 0; k < local.length / 4; k++) {
    const angles = found.subarray(names.length * k, names.length * (k + 1));
    const kept = angles.map((angle, place) => {
      const [low, high] = limits[names[place]] ?? [-Infinity, Infinity];
      return Math.min(Math.max(angle, low), high);
    });
    reduceNearReversal(angles, kept);
    if (angles.every((angle, place) => angle === kept[place])) continue;
    const rotation =
      "angle" in limits
        ? slerp(IDENTITY, local.slice(4 * k, 4 * k + 4), kept[0] / angles[0])
        : fromAngles(joint, kept);
    clamped.set(rotation, 4 * k);
  }
  return clamped;
}

/**
 * Reduces the last of clamped angles, a twist, where the twist is nearly 180 degrees.
 *
 * Beyond 180 degrees the other end of the range is nearer, and the joint must not jump from one end to the other.
 */
function reduceNearReversal(found: Numbers, kept: Numbers): void {
  const last = found.length - 1;
  if (found[last] === kept[last]) return;
  kept[last] *= Math.min(Math.max((Math.PI - Math.abs(found[last])) / (Math.PI - NEARLY_REVERSED), 0), 1);
}

/** Splits rotations (T x 4) of a joint into the angles (T x 1 or T x 3) of the table of limits, in radians. */
function jointAngles(joint: string, local: Numbers, limits: Limits): Numbers {
  if ("angle" in limits) return norms(toVector(local), 3);
  const seen = asLeft(joint, local);
  // A hand is twisted first and then bends about axes that rotate with the forearm: the axis to the thumb, about which
  // it bends up and down, stays nearly at right angles to the forearm.
  if (joint.endsWith("wrist")) {
    const angles = toEuler(seen, "XYZ");
    return angles.map((_, k) => [-angles[k + 1], angles[k + 1], angles[k - 2]][k % 3]);
  }
  const [first, second, along] = Object.values(axesOf(joint)).map((axis) => Float64Array.from(axis));
  const vectors = toVector(multiply(seen, conjugate(twist(seen, along))));
  const parts = [dot(vectors, first), dot(vectors, second), twistAngle(seen, along)];
  return vectors.map((_, k) => parts[k % 3][Math.floor(k / 3)]);
}

/** Returns the rotation (4) of a joint with given angles (3), the inverse of `jointAngles`. */
function fromAngles(joint: string, angles: Numbers): Numbers {
  const [one, two, three] = angles;
  if (joint.endsWith("wrist")) return asLeft(joint, fromEuler(Float64Array.of(three, -one, two), "XYZ"));
  const [first, second, along] = Object.values(axesOf(joint)).map((axis) => Float64Array.from(axis));
  const swing = fromVector(first.map((value, axis) => one * value + two * second[axis]));
  return asLeft(joint, multiply(swing, about(along, Float64Array.of(three))));
}

function axesOf(joint: string): Record<string, number[]> {
  return /^(left|right)_/.test(joint) ? LIMB : HEAD;
}

/** Mirrors rotations (T x 4) of a right joint to those of a left one, or back; leaves those of others unchanged. */
function asLeft(joint: string, local: Numbers): Numbers {
  return joint.startsWith("right_") ? local.map((value, k) => value * MIRROR[k % 4]) : local;
}
