/**
 * Avatars of the VRM format, 0.x and 1.0, with three.js and @pixiv/three-vrm, which this module alone needs.
 *
 * ```ts
 * const { vrm } = await loadVrm(await file.arrayBuffer());
 * scene.add(vrm.scene);
 * const poses = retarget(motion, "vrm");
 * poseVrm(vrm, poses.at(seconds)); // in each frame, before vrm.update(delta)
 * ```
 */

import { VRMLoaderPlugin, VRMUtils, type VRM } from "@pixiv/three-vrm";
import { LoadingManager } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { bytesOf } from "../formats/bytes.js";
import { VRM as RIG } from "../motion/rigs.js";
import { conjugate, IDENTITY, multiply, type Numbers } from "../motion/rotations.js";
import { checkVrm } from "./vrm-file.js";

/** An avatar, and what its file says of it. */
export interface Avatar {
  /** The avatar, which faces +z; `vrm.scene` is to be added to a scene. */
  vrm: VRM;
  /** Plain texts of unknown origin by name, such as name, authors and licenseUrl; show them as text, never as HTML. */
  metadata: Record<string, string>;
}

/** The parts of an avatar that are posed. */
export interface Posable {
  meta: { metaVersion: string };
  humanoid: { getNormalizedBoneNode(name: string): Rotatable | null };
}

interface Rotatable {
  quaternion: { set(x: number, y: number, z: number, w: number): unknown };
}

/** Joints that divide the rotation of the trunk; the last of them that an avatar has takes all of it. */
const TRUNK = ["spine", "chest", "upperChest"];
const MAX_LETTERS = 2000; // of a text of the metadata

/**
 * Loads an avatar from a file of unknown origin; nothing else is loaded.
 *
 * @param bytes - contents of a `.vrm` file.
 * @throws Error if it is no VRM avatar, damaged, too large, or refers to another file.
 */
export async function loadVrm(bytes: ArrayBuffer | Uint8Array): Promise<Avatar> {
  const file = bytesOf(bytes);
  checkVrm(file);
  const manager = new LoadingManager();
  manager.setURLModifier((url) => {
    if (!/^(data|blob):/.test(url)) throw new Error("the avatar refers to another file");
    return url;
  });
  const loader = new GLTFLoader(manager);
  loader.register((parser) => new VRMLoaderPlugin(parser));
  let vrm: VRM | undefined;
  try {
    // The loader takes a whole ArrayBuffer, of its own realm.
    const { userData } = await loader.parseAsync(file.slice().buffer, "");
    vrm = userData.vrm as VRM | undefined;
    vrm?.update(0); // what cannot be moved, such as constraints in a circle, is found here
  } catch (error) {
    throw new Error(`the avatar cannot be read: ${error instanceof Error ? error.message : error}`, { cause: error });
  }
  if (!vrm?.humanoid) throw new Error("the avatar has no humanoid bones");
  VRMUtils.rotateVRM0(vrm);
  return { vrm, metadata: textsOf(vrm.meta) };
}

/**
 * Rotates the bones of an avatar; `vrm.update` then moves its body.
 *
 * All rotations are those of the motion in the world, also where the avatar lacks bones between, such as upperChest.
 *
 * @param avatar - a VRM of @pixiv/three-vrm.
 * @param pose - (joints, 4) rotations of the rig "vrm": `retarget(motion, "vrm").at(seconds)`.
 */
export function poseVrm(avatar: Posable, pose: ArrayLike<number>): void {
  if (pose.length !== 4 * RIG.joints.length) {
    throw new Error(`the pose has ${pose.length} numbers; expected ${4 * RIG.joints.length}, those of the rig vrm`);
  }
  const nodes = RIG.joints.map(({ name }) => avatar.humanoid.getNormalizedBoneNode(name));
  const turned: Numbers[] = [];
  RIG.joints.forEach(({ parent }, joint) => {
    const local = Float64Array.from({ length: 4 }, (_, part) => pose[4 * joint + part]);
    turned.push(parent < 0 ? local : multiply(turned[parent], local));
  });
  const trunk = TRUNK.map((name) => RIG.joints.findIndex((joint) => joint.name === name));
  const last = trunk.filter((joint) => nodes[joint]).at(-1);
  if (last !== undefined) turned[last] = turned[trunk[2]];
  // In the normalized bones of VRM 0.x the figure faces -z.
  const sign = avatar.meta.metaVersion === "0" ? -1 : 1;
  RIG.joints.forEach(({ parent }, joint) => {
    let above = parent;
    while (above >= 0 && !nodes[above]) above = RIG.joints[above].parent;
    const back = above < 0 ? IDENTITY : conjugate(turned[above]);
    const [x, y, z, w] = multiply(back, turned[joint]);
    nodes[joint]?.quaternion.set(sign * x, y, sign * z, w);
  });
}

/** Returns the texts, numbers and lists of texts of the metadata as texts; images and other values are left out. */
function textsOf(meta: object): Record<string, string> {
  const texts: Record<string, string> = {};
  for (const [name, value] of Object.entries(meta)) {
    const parts: unknown[] = [value].flat().filter((part) => ["string", "number", "boolean"].includes(typeof part));
    if (parts.length) texts[name] = parts.join(", ").slice(0, MAX_LETTERS);
  }
  return texts;
}
