/** Rigs: the joints of other programs, each a table of the Python package. */

import * as mixamo from "../../../../ha2g_jax/assets/rigs/mixamo.json";
import * as vrm from "../../../../ha2g_jax/assets/rigs/vrm.json";
import { IDENTITY, unit, type Numbers } from "./rotations.js";

/** One joint of a rig. Orientations are in the world, in the axes of exported files. */
export interface RigJoint {
  name: string;
  /** Index of the parent, -1 for the root. */
  parent: number;
  /** Joint of the "ha2g" armature whose rotation it takes; null for a joint that stays at rest. */
  carries: string | null;
  /** Joint of the "ha2g" armature at whose position it lies; null for a joint at its offset. */
  place: string | null;
  /** (3,) metres from its parent in the T-pose. */
  offset: Numbers;
  /** Fraction of the rotation that it takes. */
  weight: number;
  /** (4,) orientation in the rest pose. */
  rest: Numbers;
  /** (4,) orientation in the T-pose, where the rest pose is another pose. */
  tPose?: Numbers;
  /** (3,) direction of its bone in the rest pose, in place of `tPose`. */
  direction?: Numbers;
}

/** The joints of another program, each after its parent; joint 0 is the root. Bones have the lengths of the motion. */
export interface Rig {
  name: string;
  joints: RigJoint[];
}

interface Row {
  name: string;
  parent: string | null;
  carries: string | null;
  place: string | null;
  offset: number[];
  weight?: number;
  rest?: number[];
  t_pose?: number[];
  direction?: number[];
}

/** Humanoid bones of VRM 1.0, at rest in the VRM T-pose without rotations. */
export const VRM: Rig = readRig(vrm.name, vrm.joints);

/** Bones of Mixamo's characters, which avatars of Ready Player Me have too. */
export const MIXAMO: Rig = readRig(mixamo.name, mixamo.joints);

function readRig(name: string, rows: Row[]): Rig {
  const vector = (values: number[] | undefined) => values && unit(Float64Array.from(values), values.length);
  const joints = rows.map((row) => ({
    name: row.name,
    parent: rows.findIndex((other) => other.name === row.parent),
    carries: row.carries,
    place: row.place,
    offset: Float64Array.from(row.offset),
    weight: row.weight ?? 1,
    rest: vector(row.rest) ?? IDENTITY,
    tPose: vector(row.t_pose),
    direction: vector(row.direction),
  }));
  return { name, joints };
}
