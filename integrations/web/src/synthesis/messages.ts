/** Messages between a page and its worker. */

import type { Description } from "../description.js";
import type { State } from "../motion/states.js";
import type { Generation, StreamChange, StreamOptions } from "./options.js";

/** What a page asks for. A stream has the number of the request that began it. */
export type Request =
  | { kind: "load"; description: Description; model: Uint8Array; wasm: ArrayBuffer }
  | { kind: "generate"; samples: Float32Array; options: Generation }
  | { kind: "cancel"; generation: number }
  | { kind: "stream"; options: StreamOptions }
  | { kind: "feed"; stream: number; samples: Float32Array; other?: Float32Array | undefined }
  | { kind: "flush"; stream: number }
  | { kind: "change"; stream: number; change: StreamChange }
  | { kind: "cue"; stream: number; cue: string; at?: number | undefined }
  | { kind: "clear"; stream: number; frame?: number | undefined }
  | { kind: "close"; stream: number };

export type NumberedRequest = Request & { id: number };

/** Frames that became final, (n, bones, 3), and the state of the stream after them. */
export interface Frames {
  directions: Float32Array;
  state: State;
}

/** Answer to the request of a number: the progress of a generation, its result, or why there is none. */
export type Reply = { id: number } & ({ progress: number } | { result: unknown } | { error: string });
