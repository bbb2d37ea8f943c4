/** What is asked of a model, and what it gives; types that need no network. */

import type { StyleOptions } from "./style.js";

/** How a motion is generated. */
export interface Generation extends StyleOptions {
  /** Seed of all random choices, 0 by default. */
  seed?: number;
  /** Factor of the movement about the slow mean pose, 0 to 2; 1, the default, is the unchanged motion. */
  energy?: number;
}

/** Direction vectors (T, bones, 3), and how they were made. */
export interface Generated {
  directions: Float32Array;
  meta: Record<string, unknown>;
}

/** What may change while a stream goes on. */
export interface StreamChange extends StyleOptions {
  /** Factor of the movement about the mean of the poses so far, 0 to 2; 1, the default, is the unchanged motion. */
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
  /** Mel power of 0 dB; by default a running level. */
  reference?: number;
}
