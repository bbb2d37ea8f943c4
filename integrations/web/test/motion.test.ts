/** Rotations, angles and the conversion frame by frame behave as their definitions say. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { ha2gArmature, world } from "../src/motion/armature.js";
import { fromEuler, toEuler, type Order } from "../src/motion/euler.js";
import { Motion } from "../src/motion/motion.js";
import { LivePoses, localRotations, retarget, type RigName } from "../src/motion/poses.js";
import { about, angleBetween, between, continuous, rotate, slerp, unit } from "../src/motion/rotations.js";
import { fit } from "../src/motion/fitting.js";
import { joined } from "../src/motion/solver/solver.js";
import { smoothAngle } from "../src/motion/solver/twist.js";
import { directionOf, makeMotion, SKELETON } from "./fixtures/motion.js";

const close = (found: ArrayLike<number>, expected: ArrayLike<number>, tolerance = 1e-9) => {
  assert.equal(found.length, expected.length);
  for (let k = 0; k < found.length; k++) {
    assert.ok(Math.abs(found[k] - expected[k]) < tolerance, `${Array.from(found)} is not ${Array.from(expected)}`);
  }
};
const turn = (axis: number[], degrees: number) => {
  return about(unit(Float64Array.from(axis), 3), Float64Array.of((degrees * Math.PI) / 180));
};

test("the shortest rotation takes one vector to the other, also to its opposite", () => {
  const from = unit(Float64Array.of(1, 2, 3, 0, 1, 0), 3);
  const to = unit(Float64Array.of(-2, 0.5, 1, 0, -1, 0), 3);
  close(rotate(between(from, to), from), to);
});

test("half of the way between two rotations is half of the angle, along the shorter arc", () => {
  const from = turn([0, 0, 1], 10);
  const to = turn([0, 0, 1], 70).map((value) => -value);
  assert.ok(angleBetween(slerp(from, to, 0.5), turn([0, 0, 1], 40))[0] < 1e-9);
});

test("signs of quaternions continue those of the frame before", () => {
  const first = turn([0, 1, 0], 170);
  const frames = Float64Array.of(...first.map((value) => -value), ...turn([0, 1, 0], 190));
  const signs = (q: Float64Array) => [...q.filter((_, k) => k % 2)].map(Math.sign); // of y and w
  assert.deepEqual(signs(continuous(frames)), [1, 1, 1, -1]);
  assert.deepEqual(signs(continuous(frames, frames.slice(0, 4))), [-1, -1, -1, 1]);
});

for (const order of ["XYZ", "ZXY"] as Order[]) {
  test(`Euler angles ${order} give their rotation back, at the pole too`, () => {
    const q = Float64Array.of(...turn([1, -2, 0.5], 100), ...fromEuler(Float64Array.of(0.3, Math.PI / 2, -0.4), order));
    const angles = toEuler(q, order);
    assert.ok(angleBetween(q, fromEuler(angles, order)).every((angle) => angle < 1e-6));
    assert.equal(angles[5], 0);
  });
}

test("directions fit the rotation that moved them, and say nothing where they lie on one line", () => {
  const rest = [Float64Array.of(1, 0, 0), Float64Array.of(0.6, 0.8, 0), Float64Array.of(0, 0, 1)];
  const moved = turn([1, 2, -1], 130);
  const { fitted, certainty } = fit(rest.map((row) => rotate(moved, row)), rest);
  assert.ok(angleBetween(fitted, moved)[0] < 1e-7);
  close(certainty, [1]);
  close(fit(rest.map(() => rest[0]), rest).certainty, [0]);
});

test("a twist that is not seen is held, and one that is seen clearly is kept", () => {
  const seen = [0.2, 0.2, 0.2, 2, 2, 2];
  const weights = [1, 1, 1, 0, 0, 0];
  const observations = seen.flatMap((angle, k) => [weights[k] * Math.cos(angle), weights[k] * Math.sin(angle)]);
  close(smoothAngle(Float64Array.from(observations), 15), Array(6).fill(0.2), 1e-3);
});

test("forward kinematics of the rotations gives the motion back", () => {
  const motion = makeMotion();
  const armature = ha2gArmature(SKELETON);
  const values = localRotations(motion);
  const count = armature.joints.length;
  const local = armature.joints.map((_, joint) => {
    return Float64Array.from(values.subarray(4 * (5 * count + joint), 4 * (5 * count + joint) + 4));
  });
  const { positions } = world(armature, local);
  for (const joint of ["left_elbow", "right_wrist", "neck", "left_index_2"]) {
    const index = armature.joints.indexOf(joint);
    const above = positions[armature.parents[index]];
    close(unit(positions[index].map((value, axis) => value - above[axis]), 3), directionOf(motion, joint, 5), 1e-3);
  }
});

test("frames one by one are those of pieces of any length, and do not depend on later ones", () => {
  const motion = makeMotion(12);
  const size = 3 * SKELETON.bones.length;
  const run = (lengths: number[]) => {
    const live = new LivePoses(SKELETON, motion.fps, "vrm");
    let at = 0;
    return lengths.flatMap((length) => {
      const piece = motion.directions.slice(size * at, size * (at += length));
      return [...live.animate(piece).rotations];
    });
  };
  close(run([1, 1, 1, 1, 1, 1]), run([4, 2]), 1e-6);
  assert.equal(run([12]).length, retarget(motion, "vrm").rotations.length);
});

test("a pose between two frames lies between them, and ends are held", () => {
  const poses = retarget(makeMotion(), "mixamo");
  const size = 4 * poses.joints.length;
  close(poses.at(3 / 15), poses.rotations.subarray(3 * size, 4 * size), 1e-6);
  assert.deepEqual(poses.at(-1), poses.at(0));
  assert.deepEqual(poses.at(99), poses.at(11 / 15));
  const [before, middle, after] = [3, 3.5, 4].map((frame) => Float64Array.from(poses.at(frame / 15)));
  const whole = angleBetween(before, after);
  angleBetween(before, middle).forEach((angle, joint) => assert.ok(Math.abs(angle - whole[joint] / 2) < 1e-3));
});

test("a skeleton without a rest pose, and directions that are no numbers, are refused", () => {
  assert.throws(() => ha2gArmature({ ...SKELETON, name: "constructor" }), /no rest pose of the skeleton/);
  const live = new LivePoses(SKELETON, 15, "ha2g");
  assert.throws(() => live.animate(new Float32Array(3)), /not frames of 42/);
  assert.throws(() => live.animate(new Float32Array(3 * 42).fill(NaN)), /finite/);
});

test("a rig of another name is refused", () => {
  for (const name of ["unity", "constructor", undefined] as unknown as RigName[]) {
    const message = { message: `no rig "${name}"; expected ha2g, mixamo, vrm` };
    assert.throws(() => retarget(makeMotion(), name), message);
    assert.throws(() => new LivePoses(SKELETON, 15, name), message);
  }
});

test("frame rates and directions that no file may have, and times that are no numbers, are refused", () => {
  const { directions } = makeMotion();
  for (const fps of [NaN, 0, -15, 2000]) {
    const message = { message: `the motion has ${fps} frames per second; expected 0.1 to 1000` };
    assert.throws(() => new Motion(SKELETON, directions, fps), message);
    assert.throws(() => new LivePoses(SKELETON, fps, "vrm"), message);
  }
  for (const value of [0, NaN, Infinity]) {
    const changed = directions.slice().fill(value, 3 * (42 + 2), 3 * (42 + 3));
    const where = "the bone to right_shoulder in frame 1";
    const message = `${where} has a direction of length ${value}; expected a finite one above 0`;
    assert.throws(() => new Motion(SKELETON, changed, 15), { message });
  }
  assert.throws(() => retarget(makeMotion(), "vrm").at(NaN), /the time of the pose is NaN; expected a number/);
});

test("an hour of frames is joined to the frame before", () => {
  const [joint] = joined([Float64Array.of(0, 0, 0, 1)], [new Float64Array(4 * 3600 * 60).fill(2)]) as [Float64Array];
  assert.deepEqual([joint.length, joint[3], joint[4], joint.at(-1)], [4 * (3600 * 60 + 1), 1, 2, 2]);
});
