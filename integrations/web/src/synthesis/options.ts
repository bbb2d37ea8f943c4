/** What is asked of a model, and what it gives; types that need no network. */

import type { State } from "../motion/states.js";
import type { StyleOptions } from "./style.js";

/** Frames of speech that a stream hears beyond each frame by default. */
export const LOOK_AHEAD = 8;

/** Frames of a stream that are generated in one run by default. */
export const HOP = 2;

const STYLE: Names<StyleOptions> = { speaker: true, mixture: true, values: true, variation: true };

/** All names of the options of each kind. */
const NAMES = {
  generation: { ...STYLE, seed: true, energy: true } satisfies Names<Generation>,
  change: { ...STYLE, energy: true, muted: true, state: true } satisfies Names<StreamChange>,
  stream: {
    ...STYLE,
    energy: true,
    muted: true,
    state: true,
    lookAhead: true,
    hop: true,
    seed: true,
    reference: true,
  } satisfies Names<StreamOptions>,
  load: { worker: true, wasm: true, onprogress: true },
};

type Names<Options> = Record<keyof Options, true>;

/** Checks that options are an object. */
export function checkObject(options: unknown): void {
  if (typeof options !== "object" || options === null) throw new Error(`the options are ${options}; expected an object`);
}

/**
 * Checks that options have known names and values.
 *
 * @throws Error if they are no object, one has another name, or one is null.
 */
export function checkNames(options: object, kind: keyof typeof NAMES): void {
  checkObject(options);
  const missing = Object.entries(options).find(([, value]) => value === null);
  if (missing) throw new Error(`the option ${missing[0]} is null; leave it out, or give a value`);
  const unknown = Object.keys(options).filter((name) => !Object.hasOwn(NAMES[kind], name));
  if (unknown.length) throw new Error(`no option ${unknown.join(", ")}; expected ${Object.keys(NAMES[kind]).join(", ")}`);
}

/** Checks whether a body is muted. */
export function checkMuted(muted: boolean): void {
  if (typeof muted !== "boolean") throw new Error(`muted is ${muted}; expected true or false`);
}

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
  /** What the body does where the agent does not speak, "auto" by default. */
  state?: State;
}

export interface StreamOptions extends StreamChange {
  /** Frames of speech that are heard beyond the last new frame, 8 by default. */
  lookAhead?: number;
  /** Frames that are generated in one run, 2 by default. */
  hop?: number;
  /** Seed of all random choices, 0 by default. */
  seed?: number;
  /** Mel power of 0 dB; by default a running level. */
  reference?: number;
}
