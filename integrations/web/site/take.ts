/** A motion with its sound. */

import type { Motion } from "../src/motion/motion.js";
import { isSilent } from "../src/sound/speech.js";
import type { Gesturer } from "../src/synthesis/gesturer.js";
import type { Settings } from "./settings.js";
import { RATE, type Sound } from "./sound.js";

export interface Take {
  sound: Sound;
  /** The motion with an energy of 1. */
  motion: Motion;
  /** Seconds of computation; null for a recording. */
  seconds: number | null;
}

/** Generates the motion of sound with the style and the take of the settings. */
export async function generate(
  gesturer: Gesturer,
  sound: Sound,
  settings: Settings,
  signal: AbortSignal,
  onprogress: (fraction: number) => void,
): Promise<Take> {
  const start = performance.now();
  const { style, seed } = settings;
  const motion = await gesturer.generate(sound.samples, { ...style, seed, signal, onprogress });
  return { sound, motion, seconds: (performance.now() - start) / 1000 };
}

/** Says what a take is in one sentence. */
export function describe({ sound, seconds }: Take): string {
  const length = sound.samples.length / RATE;
  const silence = isSilent(sound.samples) ? " Nothing is to be heard in it." : "";
  if (seconds === null) return `${sound.name}: ${length.toFixed(1)} s.${silence}`;
  const factor = length / seconds;
  const speed = factor < 10 ? factor.toFixed(1) : factor.toFixed(0);
  return `${sound.name}: ${length.toFixed(1)} s of gestures in ${seconds.toFixed(1)} s, ${speed} times real time.${silence}`;
}

/** Returns the name of a file to save, without a suffix. */
export function stemOf({ sound }: Take): string {
  return sound.name.replace(/\.[^.]*$/, "") || "gestures";
}
