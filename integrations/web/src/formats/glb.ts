/** GLB files: the joints of a motion as nodes, one animation, and a skinned body. */

import type { Animation } from "../motion/armature.js";
import type { Motion } from "../motion/motion.js";
import { animate } from "../motion/solver/solver.js";
import { bytesOf, floatBytes, joinBytes } from "./bytes.js";
import { readContainer, writeContainer, type Json } from "./container.js";

const FLOAT = 5126;
/** A joint that changes by less than this needs no channel: its node already has the rest rotation. */
const STILL = 1e-9;
/** Metres by which bones of the figure may differ from those of the motion. */
const TOLERANCE = 1e-4;

interface Accessor {
  bufferView: number;
  componentType: number;
  count: number;
  type: string;
  min?: number[];
  max?: number[];
}

interface View {
  buffer: number;
  byteOffset?: number;
  byteLength: number;
  target?: number;
}

/** The parts of a figure that are read or replaced. */
interface Figure extends Json {
  accessors: Accessor[];
  bufferViews: View[];
  nodes: { name?: string; translation?: number[] }[];
  scenes: { extras?: Json }[];
  meshes: { primitives: { attributes: Record<string, number>; indices: number }[] }[];
  skins: { inverseBindMatrices: number }[];
}

/**
 * Writes a motion as a `.glb` file, as `ha2g export` does.
 *
 * @param motion - motion to write.
 * @param figure - figure.glb of the same model, which Python's `write_figure` wrote: the body in its rest pose.
 * @returns bytes of the file; the same arguments give the same bytes.
 * @throws Error if the figure has other joints or bone lengths than the motion.
 */
export function writeGlb(motion: Motion, figure: ArrayBuffer | Uint8Array): Uint8Array<ArrayBuffer> {
  const { json, blob } = readContainer(bytesOf(figure));
  const body = json as Figure;
  const animation = animate(motion);
  const nodes = nodesOf(body, animation);
  const binary = new Binary();
  const clip = addAnimation(binary, animation, nodes);
  const kept = (index: number) => binary.add(contents(body, blob, index), body.accessors[index], viewOf(body, index));
  const meshes = body.meshes.map((mesh) => ({
    ...mesh,
    primitives: mesh.primitives.map((part) => ({
      ...part,
      attributes: Object.fromEntries(Object.entries(part.attributes).map(([name, index]) => [name, kept(index)])),
      indices: kept(part.indices),
    })),
  }));
  const skins = body.skins.map((skin) => ({ ...skin, inverseBindMatrices: kept(skin.inverseBindMatrices) }));
  const bytes = joinBytes(binary.chunks);
  return writeContainer(
    {
      ...json,
      scenes: [{ ...body.scenes[0], extras: describe(motion) }],
      meshes,
      skins,
      animations: [clip],
      accessors: binary.accessors,
      bufferViews: binary.views,
      buffers: [{ byteLength: bytes.length }],
    },
    bytes,
  );
}

/** The binary chunk, to which arrays are added. */
class Binary {
  readonly chunks: Uint8Array[] = [];
  readonly views: View[] = [];
  readonly accessors: Accessor[] = [];
  private length = 0;

  /** Stores the bytes of an array, and returns the index of its accessor. */
  add(bytes: Uint8Array, accessor: Omit<Accessor, "bufferView">, view: { target?: number } = {}): number {
    this.views.push({ ...view, buffer: 0, byteOffset: this.length, byteLength: bytes.length });
    const padding = new Uint8Array(-bytes.length & 3);
    this.chunks.push(bytes, padding);
    this.length += bytes.length + padding.length;
    return this.accessors.push({ ...accessor, bufferView: this.views.length - 1 }) - 1;
  }

  /** Stores rows of floating-point numbers, and returns the index of their accessor. */
  addFloats(values: ArrayLike<number>, type: "SCALAR" | "VEC4", bounds: Pick<Accessor, "min" | "max"> = {}): number {
    const count = type === "VEC4" ? values.length / 4 : values.length;
    return this.add(floatBytes(values), { componentType: FLOAT, count, type, ...bounds });
  }
}

/** Returns the node of each joint. */
function nodesOf(figure: Figure, { armature }: Animation): number[] {
  return armature.joints.map((name, joint) => {
    const index = figure.nodes.findIndex((node) => node.name === name);
    const place = figure.nodes[index]?.translation;
    if (!place?.every((value, axis) => Math.abs(value - armature.offsets[joint][axis]) < TOLERANCE)) {
      throw new Error(`the figure has no joint ${name} where the motion has it; take the figure of the same model`);
    }
    return index;
  });
}

/** Returns one linear animation with a channel for the root and for each joint that leaves its rest rotation. */
function addAnimation(binary: Binary, { armature, rotations, fps }: Animation, nodes: number[]): Json {
  const times = Float32Array.from({ length: rotations[0].length / 4 }, (_, frame) => frame / fps);
  const input = binary.addFloats(times, "SCALAR", { min: [0], max: [times[times.length - 1]] });
  const samplers: Json[] = [];
  const channels: Json[] = [];
  rotations.forEach((joint, index) => {
    const isStill = joint.every((value, k) => Math.abs(value - armature.rest[index][k & 3]) <= STILL);
    if (isStill && index > 0) return;
    const target = { node: nodes[index], path: "rotation" };
    channels.push({ sampler: samplers.length, target });
    samplers.push({ input, output: binary.addFloats(joint, "VEC4"), interpolation: "LINEAR" });
  });
  return { name: "motion", channels, samplers };
}

/** Returns the `extras` of the scene: `fps`, `frames`, `audio_seconds` and `audio` of the speech, and `meta`. */
function describe({ meta, fps, numFrames }: Motion): Json {
  const seconds = typeof meta.duration === "number" ? meta.duration : numFrames / fps;
  const audio = typeof meta.speech === "string" ? { audio: meta.speech } : {};
  return { fps, frames: numFrames, audio_seconds: seconds, ...audio, meta };
}

/** Returns the bytes of an array of the figure. */
function contents(figure: Figure, blob: Uint8Array, index: number): Uint8Array {
  const { byteOffset = 0, byteLength } = figure.bufferViews[figure.accessors[index].bufferView];
  return blob.subarray(byteOffset, byteOffset + byteLength);
}

function viewOf(figure: Figure, index: number): { target?: number } {
  const { target } = figure.bufferViews[figure.accessors[index].bufferView];
  return target === undefined ? {} : { target };
}
