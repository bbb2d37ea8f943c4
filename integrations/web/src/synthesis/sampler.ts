/** The network of a model, which samples one window at a time with ONNX Runtime. */

import * as ort from "onnxruntime-web/wasm";

import type { Description } from "../description.js";
import { FLOOR_DB, NUM_MELS } from "../sound/mel.js";
import { noiseTrack } from "../sound/noise.js";

const INPUTS = ["mel", "style", "seed_pose", "noise"];
const OUTPUT = "poses";

/** A model that samples windows. */
export class Sampler {
  private last: Promise<unknown> = Promise.resolve();

  private constructor(
    readonly description: Description,
    private readonly session: ort.InferenceSession,
  ) {}

  /**
   * Loads the network of a model, and runs it once, so that the first window is not late.
   *
   * @param description - the model's description.
   * @param model - contents of model.onnx.
   * @param wasm - WebAssembly of ONNX Runtime.
   * @throws Error if the model cannot be used.
   */
  static async create(description: Description, model: Uint8Array, wasm: ArrayBuffer): Promise<Sampler> {
    ort.env.wasm.numThreads = 1;
    ort.env.wasm.wasmBinary = wasm;
    ort.env.logLevel = "fatal"; // an exception says the same
    try {
      const session = await ort.InferenceSession.create(model);
      const sampler = new Sampler(description, session);
      const silence = new Float32Array(NUM_MELS * description.audio.columns).fill(FLOOR_DB);
      const pose = Float32Array.from(description.seed_poses[0].flat(2));
      const window = await sampler.run(silence, new Float32Array(description.style_dim), pose, 0, 0);
      if (window.length !== description.num_frames * sampler.size) throw new Error("its windows have another size");
      return sampler;
    } catch (error) {
      throw new Error(`the model cannot be used (${error instanceof Error ? error.message : error}); export it again`);
    }
  }

  /** Numbers in a frame. */
  get size(): number {
    return 3 * this.description.skeleton.bones.length;
  }

  /**
   * Samples a window; several calls are done one after the other.
   *
   * @param mel - (128, columns) dB.
   * @param style - (style_dim,).
   * @param seedPose - (M, size) unit vectors.
   * @param seed - seed of the noise, for a model that reads any.
   * @param first - number of the first frame in the motion.
   * @returns (N, size) unit vectors.
   */
  run(
    mel: Float32Array,
    style: Float32Array,
    seedPose: Float32Array,
    seed: number,
    first: number,
  ): Promise<Float32Array> {
    const { num_frames, fps, noise_dim = 0 } = this.description;
    const noise = noise_dim ? [noiseTrack(seed, first, num_frames, fps, noise_dim)] : [];
    const sampled = this.last.then(() => this.sample([mel, style, seedPose, ...noise]));
    this.last = sampled.then(() => undefined, () => undefined); // the caller has the error
    return sampled;
  }

  private async sample(values: Float32Array[]): Promise<Float32Array> {
    const { audio, num_frames, num_seed_frames, style_dim, noise_dim, skeleton, hash } = this.description;
    const pose = [num_seed_frames, skeleton.bones.length, 3];
    const shapes = [[NUM_MELS, audio.columns], [style_dim], pose, [num_frames, noise_dim ?? 0]];
    const inputs = values.map((data, k) => [INPUTS[k], new ort.Tensor("float32", data, [1, ...shapes[k]])]);
    const outputs = await this.session.run(Object.fromEntries(inputs), [OUTPUT]);
    const window = outputs[OUTPUT].data as Float32Array;
    if (!window.every(Number.isFinite)) {
      throw new Error(`model ${hash} generated values that are not finite; train or export it again`);
    }
    return window;
  }
}
