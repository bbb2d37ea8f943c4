/** BVH files: centimetres, y up, facing +z; with all rotations zero the figure is in the T-pose. */

import type { Armature } from "../motion/armature.js";
import { toEuler } from "../motion/euler.js";
import type { Motion } from "../motion/motion.js";
import type { Numbers } from "../motion/rotations.js";
import { animate } from "../motion/solver/solver.js";
import { unwrap } from "../motion/solver/twist.js";

const CENTIMETRES = 100;
const TIP = 2; // centimetres from the last joint of a chain to its end site
const DEGREE = Math.PI / 180;
const CHANNELS = "Zrotation Xrotation Yrotation";

/**
 * Writes a motion as a `.bvh` file, as `ha2g export` does.
 *
 * Every joint has three rotations in the order Z, X, Y, in degrees, unwrapped over time. The root also has its
 * position, which stays at the origin.
 *
 * @param motion - motion to write.
 * @returns bytes of the file; the same motion gives the same bytes.
 */
export function writeBvh(motion: Motion): Uint8Array<ArrayBuffer> {
  const { armature, rotations, fps } = animate(motion);
  const lines: string[] = [];
  const order = hierarchy(armature, 0, "", lines);
  const angles = order.map((joint) => degrees(rotations[joint]));
  const header = ["HIERARCHY", ...lines, "MOTION", `Frames: ${motion.numFrames}`, `Frame Time: ${frameTime(fps)}`];
  const root = "0.000000 0.000000 0.000000";
  const frames = Array.from({ length: motion.numFrames }, (_, frame) => {
    return [root, ...angles.flatMap((joint) => [...joint.subarray(3 * frame, 3 * frame + 3)].map(angle))].join(" ");
  });
  return new TextEncoder().encode(`${[...header, ...frames].join("\n")}\n`);
}

/** Returns angles (T x 3) in degrees, continuous over time, of rotations (T x 4). */
function degrees(rotations: Numbers): Numbers {
  const angles = toEuler(rotations, "ZXY");
  const axes = [0, 1, 2].map((axis) => unwrap(angles.filter((_, k) => k % 3 === axis)));
  return angles.map((_, k) => axes[k % 3][Math.floor(k / 3)] / DEGREE);
}

/** Appends the lines of a joint and all joints below it; returns the indices of these joints in the order of lines. */
function hierarchy(armature: Armature, joint: number, indent: string, lines: string[]): number[] {
  const parent = armature.parents[joint];
  const bone = armature.offsets[joint].map((value) => CENTIMETRES * value);
  const place = parent < 0 ? "6 Xposition Yposition Zposition" : "3";
  lines.push(
    `${indent}${parent < 0 ? "ROOT" : "JOINT"} ${armature.joints[joint]}`,
    `${indent}{`,
    `${indent}\tOFFSET ${numbers(bone)}`,
    `${indent}\tCHANNELS ${place} ${CHANNELS}`,
  );
  const order = [joint];
  armature.parents.forEach((above, child) => {
    if (above === joint) order.push(...hierarchy(armature, child, `${indent}\t`, lines));
  });
  if (order.length === 1) {
    const length = Math.hypot(...bone);
    const tip = length > 0 ? bone.map((value) => (TIP * value) / length) : Float64Array.of(0, TIP, 0);
    lines.push(`${indent}\tEnd Site`, `${indent}\t{`, `${indent}\t\tOFFSET ${numbers(tip)}`, `${indent}\t}`);
  }
  lines.push(`${indent}}`);
  return order;
}

function frameTime(fps: number): string {
  return String(Number((1 / fps).toFixed(10)));
}

function numbers(values: Numbers): string {
  return Array.from(values, (value) => positive(value.toFixed(6))).join(" ");
}

function angle(value: number): string {
  return positive(value.toFixed(5));
}

/** Returns the text of a number without the sign of a zero. */
function positive(text: string): string {
  return Number(text) === 0 ? text.replace("-", "") : text;
}
