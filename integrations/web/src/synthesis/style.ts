/** Styles to generate motion in, as in `ha2g_jax/synthesis/style.py`: of speakers, given values, or a random one. */

import type { Description, Take } from "../description.js";

const VARIATION = 0.3; // of the style of a speaker between two takes
const MOST_VARIATION = 2;

/**
 * A requested style, by at most one of `speaker`, `mixture` and `values`; without any, it is random.
 */
export interface StyleOptions {
  /** Name of a speaker of the model. */
  speaker?: string;
  /** Name of a speaker -> weight; the weights are divided by their sum. */
  mixture?: Record<string, number>;
  /** (style_dim,) the values themselves. */
  values?: number[];
  /** Standard deviation of what the seed adds to the style of a speaker or a mixture, 0 to 2; 0.3 by default. */
  variation?: number;
}

/** Values of a style, and plain values that describe it in the metadata of a motion. */
export interface ChosenStyle {
  values: Float32Array;
  described: Record<string, unknown>;
}

/** Returns the random choices of a seed. */
export function chooseTake(description: Description, seed: number): Take {
  const take = Number.isInteger(seed) ? description.takes[seed] : undefined;
  if (!take) throw new Error(`the seed is ${seed}; expected a whole number from 0 to ${description.takes.length - 1}`);
  return take;
}

/**
 * Returns the values of a requested style.
 *
 * @param description - model.
 * @param style - requested style.
 * @param seed - seed of the variation, and of a random style.
 * @throws Error if more than one style is requested, or it cannot be used with the model.
 */
export function chooseStyle(description: Description, style: StyleOptions, seed: number): ChosenStyle {
  const { speaker, mixture, values, variation = VARIATION } = style;
  if (style.variation !== undefined && speaker === undefined && mixture === undefined) {
    throw new Error("the variation is that of a speaker or a mixture; give one, or leave it out");
  }
  const take = chooseTake(description, seed);
  if ([speaker, mixture, values].filter((part) => part !== undefined).length > 1) {
    throw new Error("the style has more than one source; give only a speaker, a mixture or values");
  }
  if (!(typeof variation === "number" && variation >= 0 && variation <= MOST_VARIATION)) {
    throw new Error(`the variation of the style is ${variation}; expected 0 to ${MOST_VARIATION}`);
  }
  const varied = (exact: Float32Array) =>
    exact.map((value, k) => value + Math.fround(Math.fround(variation) * Math.fround(take.variation[k])));
  if (speaker !== undefined) {
    return { values: varied(styleOf(description, speaker)), described: { kind: "speaker", speaker, variation } };
  }
  if (mixture !== undefined) {
    const weights = normalized(mixture);
    const exact = new Float64Array(description.style_dim);
    for (const [name, weight] of Object.entries(weights)) {
      styleOf(description, name).forEach((value, k) => (exact[k] += weight * value));
    }
    const described = { kind: "mixture", speakers: weights, variation };
    return { values: varied(Float32Array.from(exact)), described };
  }
  if (values !== undefined) return { values: checked(values, description.style_dim), described: { kind: "values" } };
  if (!description.style_dim) return { values: new Float32Array(0), described: { kind: "none" } };
  return { values: Float32Array.from(take.style), described: { kind: "random", seed } };
}

/** Returns weights whose sum is 1. */
function normalized(weights: Record<string, number>): Record<string, number> {
  const found = Object.entries(weights);
  const total = found.reduce((sum, [, weight]) => sum + weight, 0);
  if (!(Number.isFinite(total) && total > 0 && found.every(([, weight]) => weight >= 0))) {
    const shown = found.map(([name, weight]) => `${name} ${weight}`).join(", ") || "none";
    throw new Error(`the weights of the style are ${shown}; expected numbers from 0 on, not all of them 0`);
  }
  return Object.fromEntries(found.map(([name, weight]) => [name, weight / total]));
}

/** Returns given values of a style as float32. */
function checked(values: number[], styleDim: number): Float32Array {
  const found = Float32Array.from(values);
  if (found.length !== styleDim || !found.every(Number.isFinite)) {
    throw new Error(`the style has ${found.length} values; expected ${styleDim} finite numbers`);
  }
  return found;
}

/** Returns the style (style_dim,) of a speaker of the training data. */
function styleOf(description: Description, name: string): Float32Array {
  const { speakers } = description;
  if (!Object.hasOwn(speakers, name)) {
    const known = Object.keys(speakers).join(", ");
    throw new Error(`no speaker "${name}" in the model; ${known ? `expected one of: ${known}` : "it has none"}`);
  }
  return Float32Array.from(speakers[name]);
}
