/** Windows are joined as in a whole motion, a stream keeps its promises, and wrong requests are refused. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { checkDescription } from "../src/description.js";
import { generate } from "../src/synthesis/generate.js";
import { LiveStream } from "../src/synthesis/live-stream.js";
import { Stream } from "../src/synthesis/stream.js";
import { chooseStyle } from "../src/synthesis/style.js";
import { joinWindows, numWindows, windowStride } from "../src/synthesis/windows.js";
import { makeDescription, makeSampler, noise } from "./model.js";

/** Returns the frames of a stream that hears half a second of sound and another person in pieces, and nods. */
async function streamed(samples: Float32Array, piece: number, options = {}): Promise<number[]> {
  const stream = new Stream(makeSampler(), options);
  stream.cue("nod", 0.8);
  const frames: number[] = [];
  for (let start = 0; start < samples.length; start += piece) {
    const other = samples.subarray(start, start + piece);
    const own = other.map((sample, k) => (start + k < 8000 ? sample : 0));
    frames.push(...(await stream.feed(own, other)));
  }
  frames.push(...(await stream.flush()));
  return frames;
}

/** Returns how many numbers an object holds. */
function numbersIn(value: unknown, seen = new Set<unknown>()): number {
  if (typeof value !== "object" || value === null) return 1;
  if (seen.has(value)) return 0;
  seen.add(value);
  if (ArrayBuffer.isView(value)) return value.byteLength;
  return Object.values(value).reduce((sum, part) => sum + numbersIn(part, seen), 0);
}

test("windows cover a motion", () => {
  assert.deepEqual([1, 34, 35, 54, 55].map((frames) => numWindows(frames, 34, 20)), [1, 1, 2, 2, 3]);
});

test("a window generates the last third of the one before again, and what was expected there fades out", () => {
  assert.deepEqual([[34, 4], [68, 4], [17, 7], [17, 16]].map(([window, overlap]) => windowStride(window, overlap)), [20, 42, 6, 1]);
  const windows = [0, 1].map((axis) => Float32Array.from({ length: 34 * 3 }, (_, k) => Number(k % 3 === axis)));
  const joined = joinWindows(windows, 4, 20, 3);
  const angles = Array.from({ length: 54 }, (_, k) => Math.atan2(joined[3 * k + 1], joined[3 * k]) * (180 / Math.PI));
  [0, 18, 36, 54, 72, 90].forEach((angle, k) => assert.ok(Math.abs(angles[23 + k] - angle) < 1e-3));
});

test("a motion has round(duration x fps) frames, and tells its progress", async () => {
  const fractions: number[] = [];
  const onwindow = async (fraction: number) => void fractions.push(fraction);
  const { directions } = await generate(makeSampler(), noise(16000 * 4 + 600), {}, onwindow);
  assert.equal(directions.length, 61 * makeSampler().size);
  assert.deepEqual(fractions.map((done) => Math.round(3 * done)), [1, 2, 3]);
});

test("the frames of a stream do not depend on how the sound is cut", async () => {
  const samples = noise(24000);
  for (const options of [{}, { hop: 3, lookAhead: 0 }, { hop: 26, lookAhead: 34, energy: 0.5 }]) {
    const expected = await streamed(samples, 24000, options);
    assert.equal(expected.length, 22 * makeSampler().size); // of 22.5, the even number, as in Python
    for (const piece of [333, 5000]) assert.deepEqual(await streamed(samples, piece, options), expected);
  }
});

test("a stream of ten minutes holds as much as one of two minutes", async () => {
  const stream = new Stream(makeSampler(), { hop: 10 });
  const piece = noise(8000);
  const held: number[] = [];
  for (let half = 1; half <= 1200; half++) {
    await stream.feed(piece);
    if (half === 240 || half === 1200) held.push(numbersIn(stream));
  }
  assert.equal(held[1], held[0]);
});

test("a style is that of Python's equations", () => {
  const description = makeDescription();
  const values = (style: object) => [...chooseStyle(description, style, 0).values];
  assert.deepEqual(values({ speaker: "ada", variation: 0.5 }), [1.5, 1.5]);
  assert.deepEqual(values({ mixture: { ada: 1, ben: 3 }, variation: 0 }), [2.5, -1]);
  assert.deepEqual(values({ values: [7, 8] }), [7, 8]);
  assert.deepEqual(values({}), [0.5, -0.5]);
});

test("a stream sends its part of the sound alone, and keeps a state that was changed meanwhile", async () => {
  const sent: { samples: Float32Array }[] = [];
  let answer = (_: object) => {};
  const ask = (request: { samples: Float32Array }) => {
    sent.push(request);
    return new Promise((resolve) => (answer = resolve));
  };
  const stream = new LiveStream({ ask, send() {} } as never, 1, 0.5, makeDescription(), 0, "auto");
  const fed = stream.feed(new Float32Array(1000).subarray(10, 20));
  stream.change({ state: "think" });
  assert.throws(() => stream.change({ muted: 1 } as never), /muted is 1; expected true or false/);
  answer({ directions: new Float32Array(0), state: "auto" });
  await fed;
  assert.equal(sent[0].samples.buffer.byteLength, 40);
  assert.equal(stream.state, "think");
  await assert.rejects(stream.feed(new Int16Array(4) as never), /no Float32Array/);
});

test("wrong requests are refused with a sentence", async () => {
  const sampler = makeSampler();
  const refused: [object, RegExp][] = [
    [{ speaker: "eve" }, /no speaker "eve" in the model; expected one of: ada, ben/],
    [{ speaker: "toString" }, /no speaker "toString"/],
    [{ speaker: "ada", values: [1, 2] }, /more than one source/],
    [{ mixture: { ada: 0 } }, /the weights of the style are ada 0/],
    [{ mixture: { ada: -1, ben: 2 } }, /the weights/],
    [{ values: [1] }, /1 values; expected 2/],
    [{ speaker: "ada", variation: 3 }, /the variation of the style is 3/],
    [{ variation: 1 }, /the variation is that of a speaker or a mixture/],
    [{ fps: 30 }, /no option fps; expected speaker, mixture, values, variation, .*seed/],
    [{ Seed: 1, look_ahead: 3 }, /no option Seed, look_ahead; expected/],
    [{ seed: 1 }, /the seed is 1; expected a whole number from 0 to 0/],
    [{ seed: 0.5 }, /the seed is 0.5/],
    [{ energy: NaN }, /the energy is NaN/],
    [{ energy: "1.5" }, /the energy is 1.5; expected a number/],
    [{ energy: null }, /the option energy is null; leave it out/],
    [{ seed: "length" }, /the seed is length/],
    [{ speaker: "ada", variation: [1] }, /the variation of the style is 1/],
  ];
  for (const [options, message] of refused) {
    await assert.rejects(generate(sampler, noise(16000), options), message);
    assert.throws(() => new Stream(sampler, options), message);
  }
  await assert.rejects(generate(sampler, noise(100)), /0\.006 s; expected at least 0\.2 s/);
  const others: object[] = [{ lookAhead: 35 }, { lookAhead: 1.5 }, { hop: 0 }, { hop: 27 }, { reference: -1 }];
  for (const options of [...others, { reference: "1" }, { muted: "no" }]) {
    assert.throws(() => new Stream(sampler, options), /expected/);
  }
});

test("a description that does not fit a model is refused", () => {
  assert.ok(checkDescription(makeDescription()));
  const { audio, skeleton, seed_poses, takes } = makeDescription();
  const wrong: object[] = [
    { format: "other" },
    { fps: "15" },
    { num_seed_frames: 20 },
    { audio: { ...audio, columns: 71 } },
    { skeleton: { ...skeleton, bones: [...skeleton.bones.slice(1), [0, 99]] } },
    { skeleton: { ...skeleton, lengths: [] } },
    { seed_poses: [] },
    { seed_poses: [seed_poses[0].slice(1)] },
    { speakers: { ada: [1] } },
    { takes: [] },
    { takes: [{ ...takes[0], seed_pose: 5 }] },
  ];
  for (const changes of wrong) {
    assert.throws(() => checkDescription({ ...makeDescription(), ...changes }), /^Error: model.json has /, JSON.stringify(changes));
  }
  for (const value of [null, 3, "text"]) assert.throws(() => checkDescription(value), /model.json has no object/);
});
