/** A description of a model and a network without weights, for tests. */

import { readFileSync } from "node:fs";
import type { Description } from "../src/description.js";
import type { Sampler } from "../src/synthesis/sampler.js";

const facts = JSON.parse(readFileSync("../../ha2g_jax/assets/skeletons/ted_expressive.json", "utf8"));
const BONES: number = facts.bones.length;

/** Returns a valid description, each time another object. */
export function makeDescription(changes: Partial<Description> = {}): Description {
  const pose = facts.mean_dir_vec.flat().flatMap((_: number, k: number) => (k % 3 ? [] : [[0, 1, 0]])).slice(0, BONES);
  return {
    format: "ha2g-jax 1",
    name: "test",
    method: "ha2g",
    hash: "0123",
    license: "",
    weights: "float32",
    num_frames: 34,
    num_seed_frames: 4,
    fps: 15,
    style_dim: 2,
    has_hidden_ends: true,
    audio: { sample_rate: 16000, fft_size: 1024, hop_length: 512, num_mels: 128, columns: 70, floor_db: -80 },
    skeleton: {
      name: facts.name,
      joints: facts.joints,
      bones: facts.bones.map((bone: Record<string, number>) => [bone.parent_index, bone.child_index]),
      lengths: facts.bones.map((bone: Record<string, number>) => bone.mean_length),
      mean_directions: rows(facts.mean_dir_vec.flat(2)),
      mean_pose: rows(facts.mean_pose.flat(2)),
    },
    speakers: { ada: [1, 2], ben: [3, -2] },
    seed_poses: [[pose, pose, pose, pose]],
    limbs: { head: [0, 1] },
    cues: {
      nod: { weight_times: [-0.3, 0, 0.5], weights: [0, 1, 0], times: [0], poses: {}, turns: { head: [[0.3, 0, 0]] } },
    },
    takes: [{ style: [0.5, -0.5], variation: [1, -1], seed_pose: 0 }],
    ...changes,
  };
}

/** Returns a network whose windows move every bone and depend on all inputs. */
export function makeSampler(description = makeDescription()): Sampler {
  const size = 3 * description.skeleton.bones.length;
  let runs = 0;
  const run = async (mel: Float32Array, style: Float32Array, seedPose: Float32Array) => {
    const heard = mel.reduce((sum, value) => sum + value, 0) / mel.length + style[0] + seedPose[seedPose.length - 1];
    runs++;
    const window = new Float32Array(description.num_frames * size);
    for (let at = 0; at < window.length; at += 3) {
      const angle = 0.1 * heard + 0.05 * Math.floor(at / size) + at + runs;
      window.set([Math.cos(angle), Math.sin(angle) * 0.6, Math.sin(angle) * 0.8], at);
    }
    return window;
  };
  return { description, size, run } as unknown as Sampler;
}

/** Returns noise that is the same each time. */
export function noise(count: number, loudness = 0.1): Float32Array {
  let state = 1;
  return Float32Array.from({ length: count }, () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return loudness * (state / 2 ** 31 - 1);
  });
}

function rows(values: number[]): number[][] {
  return Array.from({ length: values.length / 3 }, (_, k) => values.slice(3 * k, 3 * k + 3));
}
