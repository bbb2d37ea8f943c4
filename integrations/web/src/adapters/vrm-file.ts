/** Checks of VRM files of unknown origin, before a loader sees them. */

import { readContainer, type Json } from "../formats/container.js";
import { imageSize } from "./image-size.js";

const MAX_BYTES = 100 * 2 ** 20;
const MAX_TEXT = 16 * 2 ** 20; // bytes of the JSON text
const MAX_NODES = 10_000;
const MAX_DEPTH = 200; // nodes from a root to an end
const MAX_ARRAYS = 200 * 2 ** 20; // bytes of all arrays together, which may share bytes of the file
const MAX_SIDE = 8192; // pixels
const MAX_PIXELS = 2 ** 28; // of all images together

const COMPONENT_BYTES: Record<number, number> = { 5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4 };
const COMPONENTS: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT2: 4, MAT3: 9, MAT4: 16 };

/**
 * Checks that a file is a VRM avatar, complete in itself and of usual size.
 *
 * @param bytes - contents of the file.
 * @throws Error if it is larger than 100 MiB, no GLB file with the extension VRM or VRMC_vrm, refers to another file,
 *   has no metadata, humanoid or scene, or describes nodes, arrays or images as no avatar has them.
 */
export function checkVrm(bytes: Uint8Array): void {
  if (bytes.length > MAX_BYTES) {
    const [found, most] = [Math.ceil(bytes.length / 2 ** 20), MAX_BYTES / 2 ** 20];
    throw new Error(`the avatar has ${found} MiB; expected at most ${most}`);
  }
  const { json, blob } = readContainer(bytes, MAX_TEXT);
  const extensions = isObject(json.extensions) ? json.extensions : {};
  if (!isObject(extensions.VRM) && !isObject(extensions.VRMC_vrm)) {
    throw new Error("the GLB file is not a VRM avatar: it has neither the extension VRMC_vrm nor VRM");
  }
  checkUris(json);
  const name = isObject(extensions.VRMC_vrm) ? "VRMC_vrm" : "VRM";
  const avatar = extensions[name] as Json;
  for (const part of ["meta", "humanoid"]) {
    if (!isObject(avatar[part])) throw new Error(`the avatar has no ${part} in its extension ${name}`);
  }
  if (!rows(json, "scenes")[Number(json.scene ?? 0)]) throw new Error("the avatar has no scene");
  checkNodes(rows(json, "nodes"));
  checkArrays(rows(json, "accessors"));
  checkImages(json, blob);
}

/** Checks that no part of the document refers to another file. */
function checkUris(json: Json): void {
  const pending: unknown[] = [json];
  while (pending.length) {
    for (const [name, value] of Object.entries(pending.pop() as object)) {
      if (name === "uri" && !(typeof value === "string" && value.startsWith("data:"))) {
        throw new Error("the avatar refers to another file; expected one that is complete in itself");
      }
      if (typeof value === "object" && value !== null) pending.push(value);
    }
  }
}

/** Checks that the nodes are trees. */
function checkNodes(nodes: Json[]): void {
  const children = nodes.map((node) => (Array.isArray(node.children) ? (node.children as unknown[]) : []));
  const below = new Set(children.flat());
  const isTree =
    nodes.length <= MAX_NODES &&
    below.size === children.flat().length &&
    [...below].every((child) => Number.isInteger(child) && nodes[child as number]);
  // The nodes of one generation after the other; those in a circle are never reached.
  let generation = nodes.map((_, index) => index).filter((index) => !below.has(index));
  let reached = 0;
  for (let depth = 0; isTree && generation.length && depth < MAX_DEPTH; depth++) {
    reached += generation.length;
    generation = generation.flatMap((index) => children[index] as number[]);
  }
  if (reached !== nodes.length) throw new Error("the nodes of the avatar are too many, or not a tree of usual depth");
}

/** Checks the sizes of the arrays, whose memory a loader reserves before it looks for their bytes. */
function checkArrays(accessors: Json[]): void {
  const sizes = accessors.map(({ count, componentType, type }) =>
    Number.isInteger(count) && Number(count) >= 0
      ? Number(count) * COMPONENT_BYTES[Number(componentType)] * COMPONENTS[String(type)]
      : NaN,
  );
  const total = sizes.reduce((sum, size) => sum + size, 0);
  if (!(total <= MAX_ARRAYS)) throw new Error("the avatar describes arrays that are damaged or too large");
}

/** Checks the sizes of images, which are small in a file and large in memory. */
function checkImages(json: Json, blob: Uint8Array): void {
  const views = rows(json, "bufferViews");
  let pixels = 0;
  for (const { uri, bufferView } of rows(json, "images")) {
    const { byteOffset = 0, byteLength = 0 } = views[Number(bufferView)] ?? {};
    const start = Number(byteOffset);
    const bytes = typeof uri === "string" ? decoded(uri) : blob.subarray(start, start + Number(byteLength));
    const [width, height] = imageSize(bytes) ?? [];
    if (width === undefined || height === undefined) throw new Error("an image of the avatar is neither PNG nor JPEG");
    pixels += width * height;
    if (Math.max(width, height) > MAX_SIDE || pixels > MAX_PIXELS) {
      throw new Error(`an image of the avatar has ${width} x ${height} pixels; expected at most ${MAX_SIDE} on a side`);
    }
  }
}

/** Returns the bytes of a data URI in base64, none of another. */
function decoded(uri: string): Uint8Array {
  const [, text] = /^data:[^,]*;base64,(.*)$/s.exec(uri) ?? [];
  if (text === undefined) return new Uint8Array();
  try {
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  } catch (error) {
    throw new Error("an image of the avatar is damaged", { cause: error });
  }
}

/** Returns a list of objects of the document, empty without it. */
function rows(json: Json, name: string): Json[] {
  const found = json[name] ?? [];
  if (!Array.isArray(found) || !found.every(isObject)) throw new Error(`the avatar has no list of objects as ${name}`);
  return found;
}

function isObject(value: unknown): value is Json {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}
