/** A recording has the frames of all its sound, although frames come later than the sound. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Recording } from "../site/recording.js";
import { RATE } from "../site/sound.js";

const FPS = 15;
const SIZE = 3; // values of a frame

/** Records `seconds` of sound, whose frames come 5 frames late, and returns the numbers of the frames. */
function record(seconds: number, before = 0): { frames: number[]; samples: number } {
  const recording = new Recording(FPS, before);
  const first = Math.floor((before * FPS) / RATE) - 5;
  for (let k = 0; k < seconds * FPS; k++) {
    recording.hear(new Float32Array(Math.round(((k + 1) * RATE) / FPS) - Math.round((k * RATE) / FPS)));
    recording.see(first + k, new Float32Array(SIZE).fill(first + k), SIZE);
  }
  const last = first + seconds * FPS;
  recording.see(last, Float32Array.from({ length: 5 * SIZE }, (_, i) => last + Math.floor(i / SIZE)), SIZE);
  const { samples, directions } = recording.result(SIZE)!;
  const frames = Array.from({ length: directions.length / SIZE }, (_, i) => directions[SIZE * i]);
  return { frames, samples: samples.length };
}

test("frames of sound from before are left out, and those that come late are kept", () => {
  const { frames, samples } = record(4, 2 * RATE);
  assert.equal(samples, 4 * RATE);
  assert.deepEqual(frames, Array.from({ length: 4 * FPS }, (_, k) => 2 * FPS + k));
});

test("a recording of the greatest length has its last frames, and nothing later", () => {
  const { frames, samples } = record(602);
  assert.ok(samples >= 600 * RATE && samples < 601 * RATE);
  assert.deepEqual([frames[0], frames.length, frames.at(-1)], [0, 600 * FPS, 600 * FPS - 1]);
});
