/** A model that runs in a worker. */

import type { Description } from "../description.js";
import type { Motion } from "../motion/motion.js";
import type { StyleOptions } from "./style.js";

export interface LoadOptions {
  /** URL of worker.js, on the origin of the page; by default beside the module. */
  worker?: string | URL;
  /** URL of ort.wasm.gz; by default beside the module. */
  wasm?: string | URL;
  /** Called with the fraction of the bytes that have arrived, 0 to 1. */
  onprogress?: (fraction: number) => void;
}

export interface GenerateOptions extends StyleOptions {
  /** Seed of all random choices, 0 by default. */
  seed?: number;
  /** Factor of the movement about the slow mean pose, 0 to 2; 1 is the unchanged motion. */
  energy?: number;
  /** Called with the fraction of the windows that are generated, 0 to 1. */
  onprogress?: (fraction: number) => void;
  /** Ends the generation; the promise is then rejected with the reason of the signal. */
  signal?: AbortSignal;
}

/** What may change while a stream goes on. */
export interface StreamChange extends StyleOptions {
  /** Factor of the movement about the mean of the poses so far, 0 to 2. */
  energy?: number;
  /** Whether the arms rest. */
  muted?: boolean;
}

export interface StreamOptions extends StreamChange {
  /** Frames of speech that are heard beyond the last new frame, 3 by default. */
  lookAhead?: number;
  /** Frames that are generated in one run, 1 by default. */
  hop?: number;
  /** Seed of all random choices, 0 by default. */
  seed?: number;
}

/** Motion that follows speech. */
export interface LiveStream {
  /** Seconds from a moment of the speech to its frame at most, without the time of the computation. */
  readonly latency: number;
  /** Takes the next mono samples at 16 kHz, and returns the frames that became final, (n, bones, 3) unit vectors. */
  feed(samples: Float32Array): Promise<Float32Array>;
  /** Ends the stream, and returns the rest of the frames. */
  flush(): Promise<Float32Array>;
  /** Changes energy, mute or style with the next frames, within half a second. */
  change(change: StreamChange): void;
  /** Ends the stream without its last frames. */
  close(): void;
}

/** A model that turns speech into gestures; it computes in a worker. */
export class Gesturer {
  private constructor(readonly description: Description) {}

  /**
   * Loads a model.
   *
   * @param model - URL of model.onnx; its description is model.json beside it.
   */
  static async load(model: string | URL, options: LoadOptions = {}): Promise<Gesturer> {
    throw new Error(`not built yet: ${model} ${options}`);
  }

  /**
   * Generates gestures for speech; the same arguments give the same motion as Python's `OnnxModel.generate`.
   *
   * @param samples - mono samples at 16 kHz.
   * @returns Motion of round(duration x fps) frames.
   */
  async generate(samples: Float32Array, options: GenerateOptions = {}): Promise<Motion> {
    throw new Error(`not built yet: ${samples} ${options}`);
  }

  /** Begins a motion that follows speech. */
  async stream(options: StreamOptions = {}): Promise<LiveStream> {
    throw new Error(`not built yet: ${options}`);
  }

  /** Ends the worker. */
  close(): void {}
}
