/** Avatars point their arms where the motion points, and a file that is no avatar is refused with a message. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { runInNewContext } from "node:vm";
import { Object3D, Vector3 } from "three";
import { imageSize } from "../src/adapters/image-size.js";
import { poseTalkingHead, talkingHeadBones } from "../src/adapters/talkinghead.js";
import { loadVrm, poseVrm } from "../src/adapters/vrm.js";
import type { Json } from "../src/formats/container.js";
import { retarget } from "../src/motion/poses.js";
import { MIXAMO, VRM as RIG, type Rig } from "../src/motion/rigs.js";
import { avatarFile, makeAvatar } from "./fixtures/avatar.js";
import { directionOf, makeMotion } from "./fixtures/motion.js";

const FRAMES = [0, 5, 11];
/** First and second bone of VRM, and the joint of the motion at the end of the first. */
const ARMS = ["left", "right"].flatMap((side) => [
  [`${side}UpperArm`, `${side}LowerArm`, `${side}_elbow`],
  [`${side}LowerArm`, `${side}Hand`, `${side}_wrist`],
  [`${side}IndexProximal`, `${side}IndexIntermediate`, `${side}_index_2`],
]);

/** Degrees; the fingers of the table of a rig are not quite straight at rest. */
const tolerance = (joint: string) => (/elbow|wrist/.test(joint) ? 1 : 5);

const motion = makeMotion();
const poses = retarget(motion, "vrm");
const poseOf = (frame: number) => poses.at(frame / motion.fps);

/** Checks that the bone between two objects points as the bone of the motion to a joint. */
function assertAligned(first: Object3D, second: Object3D, joint: string, frame: number): void {
  const bone = second.getWorldPosition(new Vector3()).sub(first.getWorldPosition(new Vector3()));
  const angle = (bone.angleTo(new Vector3(...directionOf(motion, joint, frame))) * 180) / Math.PI;
  assert.ok(angle < tolerance(joint), `${joint} is ${angle.toFixed(2)} degrees away in frame ${frame}`);
}

/** Returns objects for the joints of a rig in its T-pose, without those in `without`. */
function objectsOf(rig: Rig, without: string[] = []): Map<string, Object3D> {
  const objects = new Map<string, Object3D>();
  const shift = new Map<string, Vector3>();
  rig.joints.forEach(({ name, parent, offset }) => {
    const above = parent < 0 ? undefined : rig.joints[parent].name;
    const place = new Vector3(...offset).add((above && shift.get(above)) || new Vector3());
    const object = new Object3D();
    object.name = name;
    object.position.copy(place);
    shift.set(name, without.includes(name) ? place : new Vector3());
    if (without.includes(name)) objects.set(name, objects.get(above ?? "") ?? object);
    else {
      objects.get(above ?? "")?.add(object);
      objects.set(name, object);
    }
  });
  without.forEach((name) => objects.delete(name));
  return objects;
}

for (const without of [[], ["upperChest", "leftShoulder", "rightShoulder"], ["chest", "upperChest", "neck"]]) {
  test(`a humanoid without [${without}] points its arms as the motion does`, () => {
    const objects = objectsOf(RIG, without);
    const humanoid = { getNormalizedBoneNode: (name: string) => objects.get(name) ?? null };
    for (const frame of FRAMES) {
      poseVrm({ meta: { metaVersion: "1" }, humanoid }, poseOf(frame));
      objects.get("hips")!.updateMatrixWorld(true);
      for (const [first, second, joint] of ARMS) {
        assertAligned(objects.get(first)!, objects.get(second)!, joint, frame);
      }
    }
  });
}

test("a trunk without upperChest leans as far as one with it", () => {
  const whole = objectsOf(RIG);
  const short = objectsOf(RIG, ["upperChest"]);
  for (const objects of [whole, short]) {
    const humanoid = { getNormalizedBoneNode: (name: string) => objects.get(name) ?? null };
    poseVrm({ meta: { metaVersion: "1" }, humanoid }, poseOf(5));
    objects.get("hips")!.updateMatrixWorld(true);
  }
  const up = (object: Object3D) => new Vector3(0, 1, 0).transformDirection(object.matrixWorld);
  assert.ok(up(short.get("chest")!).angleTo(up(whole.get("upperChest")!)) < 1e-6);
});

for (const version of ["0", "1"] as const) {
  test(`a VRM file of version ${version} is loaded and points its arms as the motion does`, async () => {
    const { vrm, metadata } = await loadVrm(avatarFile(makeAvatar(version)));
    for (const frame of FRAMES) {
      poseVrm(vrm, poseOf(frame));
      vrm.update(0);
      vrm.scene.updateMatrixWorld(true);
      const bone = (name: string) => vrm.humanoid.getRawBoneNode(name as never)!;
      for (const [first, second, joint] of ARMS) {
        assertAligned(bone(first), bone(second), joint, frame);
      }
    }
    assert.equal(metadata[version === "0" ? "title" : "name"], "<script>alert(1)</script>");
    assert.equal(metadata[version === "0" ? "author" : "authors"], version === "0" ? "someone" : "someone, another");
  });
}

test("an avatar is read from a part of a Buffer, and from an ArrayBuffer of another realm", async () => {
  const file = avatarFile(makeAvatar("1"));
  const part = Buffer.concat([Buffer.alloc(9), file]).subarray(9);
  const other = runInNewContext(`new ArrayBuffer(${file.length})`) as ArrayBuffer;
  new Uint8Array(other).set(file);
  for (const bytes of [part, other]) assert.equal((await loadVrm(bytes)).metadata.authors, "someone, another");
});

test("a pose may be a plain array", () => {
  const turned: number[][] = [];
  const bone = { quaternion: { set: (...values: number[]) => turned.push(values) } };
  const humanoid = { getNormalizedBoneNode: () => bone };
  for (const pose of [poseOf(5), Array.from(poseOf(5))]) poseVrm({ meta: { metaVersion: "0" }, humanoid }, pose);
  assert.deepEqual(turned.slice(RIG.joints.length), turned.slice(0, RIG.joints.length));
});

test("the size of a JPEG is found after bytes that fill up, and not after a marker without a length", () => {
  const after = (...bytes: number[]) => {
    const frame = [0xff, 0xc0, 0, 11, 8, 0, 10, 0, 20, 1, 1, 0x11, 0];
    return imageSize(Uint8Array.of(0xff, 0xd8, 0xff, 0xe0, 0, 4, 0, 0, ...bytes, ...frame));
  };
  assert.deepEqual([after(), after(0xff), after(0xff, 0xff)], [[20, 10], [20, 10], [20, 10]]);
  assert.deepEqual([after(0xff, 0x01, 0, 2), after(0xff, 0xd0, 0, 2), after(0)], [undefined, undefined, undefined]);
});

const avatar = makeAvatar("1");
const circle = structuredClone(avatar.nodes) as Json[];
circle[3].children = [1];
const chain = Array.from({ length: 5000 }, (_, k) => (k < 4999 ? { children: [k + 1] } : {}));
const png = new Uint8Array(24);
new DataView(png.buffer).setUint32(0, 0x89504e47);
new DataView(png.buffer).setUint32(16, 60000);
new DataView(png.buffer).setUint32(20, 60000);
const images: Json = {
  images: [{ bufferView: 0 }],
  bufferViews: [{ buffer: 0, byteLength: 24 }],
  buffers: [{ byteLength: 24 }],
};

const hostile: Record<string, [Uint8Array, RegExp]> = {
  "a text": [new TextEncoder().encode("this is no avatar, whatever its name"), /not a GLB file/],
  "an empty file": [new Uint8Array(), /not a GLB file/],
  "a file cut short": [avatarFile(avatar).slice(0, -40), /not complete/],
  "a file that is too large": [new Uint8Array(100 * 2 ** 20 + 1), /100/],
  "a GLB file of something else": [avatarFile({ asset: { version: "2.0" } }), /not a VRM avatar/],
  "an avatar with an image elsewhere": [avatarFile({ ...avatar, images: [{ uri: "//a.b/c.png" }] }), /another file/],
  "an avatar with a buffer beside it": [avatarFile({ ...avatar, buffers: [{ uri: "x.bin" }] }), /another file/],
  "a uri in an extension": [avatarFile({ ...avatar, extensions: { VRMC_vrm: {}, A: { uri: "//a" } } }), /another file/],
  "nodes in a circle": [avatarFile({ ...avatar, nodes: circle }), /tree/],
  "nodes of great depth": [avatarFile({ ...avatar, nodes: chain }), /tree/],
  "an array of 4 GB": [
    avatarFile({ ...avatar, accessors: [{ count: 2 ** 30, componentType: 5126, type: "SCALAR" }] }),
    /too large/,
  ],
  "an image of 3.6 gigapixels": [avatarFile({ ...avatar, ...images }, png), /60000 x 60000/],
  "an avatar without metadata": [
    avatarFile({ ...avatar, extensions: { VRMC_vrm: { humanoid: {} } } }),
    /the avatar has no meta in its extension VRMC_vrm/,
  ],
  "an avatar without a humanoid": [
    avatarFile({ ...avatar, extensions: { VRM: { meta: {}, humanoid: [] } } }),
    /the avatar has no humanoid in its extension VRM$/,
  ],
  "an avatar without a scene": [avatarFile({ ...avatar, scenes: [] }), /the avatar has no scene/],
  "an avatar without bones": [avatarFile({ ...avatar, extensions: { VRMC_vrm: { specVersion: "1.0" } } }), /avatar/],
};
for (const [name, [bytes, message]] of Object.entries(hostile)) {
  test(`${name} is refused with a message`, async () => {
    await assert.rejects(loadVrm(bytes), (error: Error) => {
      assert.match(error.message, message);
      assert.ok(!error.message.includes("\n"));
      return true;
    });
  });
}

test("TalkingHead's bones have the names of Mixamo without its prefix, and only those of the upper body", () => {
  const bones = talkingHeadBones(retarget(motion, "mixamo").at(0));
  for (const name of ["Spine", "Spine2", "Neck", "Head", "LeftShoulder", "RightForeArm", "LeftHandIndex2"]) {
    assert.equal(bones.get(name)?.length, 4, name);
  }
  assert.ok(![...bones.keys()].some((name) => /Hips|Leg|Foot|:/.test(name)));
  assert.throws(() => talkingHeadBones(poseOf(0)), /mixamo/);
});

test("an avatar with Mixamo's bones points its arms as the motion does", () => {
  const { armature } = mixamoInItsAxes();
  for (const frame of FRAMES) {
    poseTalkingHead({ armature }, retarget(motion, "mixamo").at(frame / motion.fps));
    armature.updateMatrixWorld(true);
    const bone = (name: string) => armature.getObjectByName(name)!;
    for (const [first, second, joint] of [
      ["LeftArm", "LeftForeArm", "left_elbow"],
      ["RightForeArm", "RightHand", "right_wrist"],
      ["LeftHandRing1", "LeftHandRing2", "left_ring_2"],
    ]) {
      assertAligned(bone(first), bone(second), joint, frame);
    }
  }
});

/** Returns objects with Mixamo's names and rest rotations, in the T-pose. */
function mixamoInItsAxes(): { armature: Object3D } {
  const still = objectsOf(MIXAMO);
  const bones: Object3D[] = [];
  MIXAMO.joints.forEach(({ name, parent, rest }) => {
    const bone = new Object3D();
    bone.name = name.replace("mixamorig:", "");
    const place = still.get(name)!.getWorldPosition(new Vector3());
    const above = bones[parent];
    bone.quaternion.set(...([...rest] as [number, number, number, number]));
    if (above) {
      above.updateMatrixWorld(true);
      bone.quaternion.premultiply(above.getWorldQuaternion(bone.quaternion.clone()).invert());
      above.add(bone);
    }
    bone.position.copy(above ? above.worldToLocal(place) : place);
    bones.push(bone);
  });
  return { armature: bones[0] };
}
