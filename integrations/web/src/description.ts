/** Description of a model, the file model.json beside model.onnx; its fields are those of the ONNX metadata. */

import { windowColumns } from "./sound/mel.js";

const FORMAT = "ha2g-jax 1";

/** Tree of joints; joint 0 is the root. Metres, y points down, the person's left is +x. */
export interface Skeleton {
  name: string;
  joints: string[];
  /** Parent joint and child joint of each bone. */
  bones: [number, number][];
  /** Length of each bone in metres. */
  lengths: number[];
  /** (bones, 3) mean direction vectors, not of unit length. */
  mean_directions: number[][];
  /** (joints, 3) mean positions in metres. */
  mean_pose: number[][];
}

/** How the spectrogram of the model is computed. */
export interface AudioDescription {
  sample_rate: number;
  fft_size: number;
  hop_length: number;
  num_mels: number;
  columns: number;
  floor_db: number;
}

/** Random numbers that Python draws for one seed. */
export interface Take {
  /** (style_dim,) values of a random style. */
  style: number[];
  /** (style_dim,) normal values that are added to the style of a speaker, times the variation. */
  variation: number[];
  /** Number of the seed pose. */
  seed_pose: number;
}

/** A gesture that can be asked for; times are in seconds from the peak of its stroke. */
export interface Keyframes {
  weight_times: number[];
  /** How far the gesture replaces the motion: 0 at both ends, 1 at the peak. */
  weights: number[];
  /** Moments of the keyframes. */
  times: number[];
  /** (keyframes, bones, 3) unit vectors of a limb, by its name. */
  poses: Record<string, number[][][]>;
  /** (keyframes, 3) rotation vectors in radians that are added to the motion of a limb, by its name. */
  turns: Record<string, number[][]>;
}

/** A model without its networks. */
export interface Description {
  format: string;
  name: string;
  method: string;
  hash: string;
  license: string;
  /** Form of the weights in the file: float32, float16 or int8. */
  weights: string;
  /** Frames of a window, N. */
  num_frames: number;
  /** Frames of the seed pose, M. */
  num_seed_frames: number;
  fps: number;
  style_dim: number;
  /** Channels of the noise that a model which samples reads; missing for the others. */
  noise_dim?: number;
  has_hidden_ends: boolean;
  audio: AudioDescription;
  skeleton: Skeleton;
  /** Name of a speaker -> values of the style. */
  speakers: Record<string, number[]>;
  /** (K, M, bones, 3) calm poses that motion starts from. */
  seed_poses: number[][][][];
  /** Draws of the seeds from 0 on. */
  takes: Take[];
  /** Bones of head, spine, shoulders and arms, by name. */
  limbs: Record<string, number[]>;
  /** Gestures that can be asked for, by name. */
  cues: Record<string, Keyframes>;
}

/**
 * Checks the contents of a model.json.
 *
 * @param value - what JSON.parse returned.
 * @returns the same value.
 * @throws Error if it does not describe a model.
 */
export function checkDescription(value: unknown): Description {
  const wrong = (what: string) => new Error(`model.json has ${what}; write it again with ha2g web`);
  if (typeof value !== "object" || value === null) throw wrong("no object");
  const found = value as Description;
  if (found.format !== FORMAT) throw wrong(`another format than "${FORMAT}"`);
  for (const name of ["name", "method", "hash", "license", "weights"] as const) {
    if (typeof found[name] !== "string") throw wrong(`no text ${name}`);
  }
  const ranges = {
    num_frames: [17, 68],
    num_seed_frames: [1, 34],
    fps: [15, 30],
    style_dim: [0, 8192],
    noise_dim: [0, 8192],
  } as const;
  for (const [name, [least, most]] of Object.entries(ranges)) {
    const size = found[name as keyof typeof ranges] ?? (name === "noise_dim" ? 0 : NaN);
    if (!(Number.isInteger(size) && size >= least && size <= most)) throw wrong(`no ${name} from ${least} to ${most}`);
  }
  const { num_frames, num_seed_frames, style_dim, fps, audio, skeleton } = found;
  if (2 * num_seed_frames > num_frames) throw wrong("a seed pose of more than half a window");
  const expected = { sample_rate: 16000, fft_size: 1024, hop_length: 512, num_mels: 128, floor_db: -80 };
  for (const [name, number] of Object.entries(expected)) {
    if (audio?.[name as keyof typeof expected] !== number) throw wrong(`an audio.${name} that is not ${number}`);
  }
  const columns = windowColumns(num_frames, fps);
  if (audio.columns !== columns) throw wrong(`an audio.columns that is not ${columns}`);
  if (!isSkeleton(skeleton)) throw wrong("no skeleton");
  const bones = skeleton.bones.length;
  if (!isArray(found.seed_poses, [-1, num_seed_frames, bones, 3])) throw wrong("seed poses of another shape");
  for (const [name, style] of Object.entries(found.speakers ?? {})) {
    if (!isArray(style, [style_dim])) throw wrong(`a style of "${name}" with another number of values`);
  }
  const isTake = (take: Take) =>
    isArray(take?.style, [style_dim]) &&
    isArray(take.variation, [style_dim]) &&
    found.seed_poses[take.seed_pose] !== undefined;
  if (!areCues(found)) throw wrong("no cues");
  if (!Array.isArray(found.takes) || !found.takes.length || !found.takes.every(isTake)) throw wrong("no takes");
  return found;
}

/** Returns whether a value is a skeleton in which each bone has two joints, and each joint but the root one bone. */
function isSkeleton(value: unknown): value is Skeleton {
  const { name, joints, bones, lengths, mean_directions, mean_pose } = (value ?? {}) as Skeleton;
  if (typeof name !== "string" || !Array.isArray(joints) || !joints.every((joint) => typeof joint === "string")) {
    return false;
  }
  const children = Array.isArray(bones) ? bones.map((bone) => bone?.[1]) : [];
  return (
    isArray(bones, [joints.length - 1, 2]) &&
    bones.flat().every((joint) => joints[joint] !== undefined) &&
    new Set([0, ...children]).size === joints.length &&
    isArray(lengths, [bones.length]) &&
    isArray(mean_directions, [bones.length, 3]) &&
    isArray(mean_pose, [joints.length, 3])
  );
}

/** Returns whether the cues of a model have the shapes that its limbs and their keyframes say. */
function areCues({ skeleton, limbs = {}, cues }: Description): boolean {
  const isLimb = (bones: unknown) => isArray(bones, [-1]) && (bones as number[]).every((bone) => skeleton.bones[bone]);
  return Boolean(cues) && Object.values(limbs).every(isLimb) && Object.values(cues).every((cue) => {
    const count = cue?.times?.length;
    return (
      isArray(cue?.weight_times, [-1]) &&
      isArray(cue.weights, [cue.weight_times.length]) &&
      isArray(cue.times, [-1]) &&
      Object.entries(cue.poses ?? {}).every(([limb, poses]) => isArray(poses, [count, limbs[limb]?.length ?? 0, 3])) &&
      Object.entries(cue.turns ?? {}).every(([limb, turns]) => limbs[limb] && isArray(turns, [count, 3]))
    );
  });
}

/** Returns whether a value is nested arrays of finite numbers of a shape; -1 is any length from 1 on. */
function isArray(value: unknown, shape: number[]): boolean {
  if (!shape.length) return typeof value === "number" && Number.isFinite(value);
  const [length, ...rest] = shape as [number, ...number[]];
  if (!Array.isArray(value) || (length < 0 ? value.length < 1 : value.length !== length)) return false;
  return value.every((part) => isArray(part, rest));
}
