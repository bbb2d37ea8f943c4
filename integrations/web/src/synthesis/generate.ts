/** Motion from a whole recording, as in `ha2g_jax/synthesis/generator.py` and `onnx_model.py`. */

import { energy as applyEnergy, checkEnergy } from "../motion/control/effects.js";
import { round } from "../rounding.js";
import { logMel, melWindow, SAMPLE_RATE } from "../sound/mel.js";
import { checkSpeech } from "../sound/speech.js";
import { VERSION } from "../version.js";
import { checkNames, type Generated, type Generation } from "./options.js";
import type { Sampler } from "./sampler.js";
import { chooseStyle, chooseTake } from "./style.js";
import { joinWindows, numWindows, windowStride } from "./windows.js";

/**
 * Generates gestures for speech; the same arguments give the same motion.
 *
 * @param sampler - model.
 * @param speech - mono samples at 16 kHz.
 * @param options - style, seed and energy.
 * @param onwindow - called after each window with the fraction of the windows that are done; if its promise is
 *   rejected, so is that of the motion.
 * @returns exactly round(duration x fps) frames, at least 1.
 * @throws Error if the speech or an option cannot be used.
 */
export async function generate(
  sampler: Sampler,
  speech: Float32Array,
  options: Generation = {},
  onwindow: (fraction: number) => Promise<void> = async () => {},
): Promise<Generated> {
  const { description, size } = sampler;
  const { num_frames, num_seed_frames, fps, audio, skeleton, seed_poses } = description;
  checkNames(options, "generation");
  const { seed = 0, energy = 1 } = options;
  const style = chooseStyle(description, options, seed);
  checkEnergy(energy);
  const samples = checkSpeech(speech);
  const duration = samples.length / SAMPLE_RATE;
  const frames = Math.max(1, round(duration * fps));
  const mel = logMel(samples);
  const stride = windowStride(num_frames, num_seed_frames);
  const count = numWindows(frames, num_frames, stride);
  const windows: Float32Array[] = [];
  let seedPose: Float32Array = Float32Array.from(seed_poses[chooseTake(description, seed).seed_pose].flat(2));
  for (let index = 0; index < count; index++) {
    const first = index * stride;
    const heard = melWindow(mel, first, audio.columns, fps);
    const window = await sampler.run(heard, style.values, seedPose, seed, first);
    windows.push(window);
    seedPose = window.slice(stride * size, (stride + num_seed_frames) * size);
    await onwindow((index + 1) / count);
  }
  const joined = joinWindows(windows, num_seed_frames, stride, size);
  const directions = applyEnergy(skeleton, joined.slice(0, frames * size), fps, energy);
  const meta = {
    version: `ha2g-web ${VERSION}`,
    model: description.name,
    checkpoint: description.hash,
    speech: null,
    duration,
    style: style.described,
    seed,
    ...(energy === 1 ? {} : { controls: { energy } }),
  };
  return { directions, meta };
}
