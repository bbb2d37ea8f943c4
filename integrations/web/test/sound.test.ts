/** Sound is read and resampled without loss, and files that are no sound are refused with a sentence. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { runInNewContext } from "node:vm";
import { rateOf } from "../site/containers.js";
import { openSound } from "../site/sound.js";
import { round, toFloat16 } from "../src/rounding.js";
import { logMel, melPower, NUM_MELS } from "../src/sound/mel.js";
import { resample } from "../src/sound/resample.js";
import { RunningMel } from "../src/sound/running-mel.js";
import { RunningResampler } from "../src/sound/running-resampler.js";
import { isSilent } from "../src/sound/speech.js";
import { readSound } from "../src/sound/wav.js";
import { noise } from "./model.js";

const sine = (hertz: number, rate: number, seconds = 0.5) =>
  Float32Array.from({ length: rate * seconds }, (_, k) => 0.5 * Math.sin((2 * Math.PI * hertz * k) / rate));

function wav(samples: number[], { code = 1, bits = 16, rate = 16000, channels = 1, declared = -1 } = {}): ArrayBuffer {
  const size = bits / 8;
  const view = new DataView(new ArrayBuffer(44 + samples.length * size));
  [..."RIFF"].forEach((letter, k) => view.setUint8(k, letter.charCodeAt(0)));
  [..."WAVEfmt "].forEach((letter, k) => view.setUint8(8 + k, letter.charCodeAt(0)));
  view.setUint32(16, 16, true);
  view.setUint16(20, code, true);
  view.setUint16(22, channels, true);
  view.setUint32(24, rate, true);
  view.setUint16(34, bits, true);
  [..."data"].forEach((letter, k) => view.setUint8(36 + k, letter.charCodeAt(0)));
  view.setUint32(40, declared < 0 ? samples.length * size : declared, true);
  samples.forEach((sample, k) => {
    const at = 44 + k * size;
    if (code === 3) size === 4 ? view.setFloat32(at, sample, true) : view.setFloat64(at, sample, true);
    else if (size === 1) view.setUint8(at, sample * 128 + 128);
    else if (size === 2) view.setInt16(at, sample * 2 ** 15, true);
    else if (size === 3) view.setUint16(at, (sample * 2 ** 23) & 0xffff, true), view.setInt8(at + 2, (sample * 2 ** 23) >> 16);
    else view.setInt32(at, sample * 2 ** 31, true);
  });
  return view.buffer;
}

test("samples of every kind are read", () => {
  const samples = Array.from({ length: 4000 }, (_, k) => ((k % 7) - 3) / 8);
  for (const [code, bits] of [[1, 8], [1, 16], [1, 24], [1, 32], [3, 32], [3, 64]]) {
    assert.deepEqual([...readSound(wav(samples, { code, bits }))], samples, `${code} ${bits}`);
  }
});

test("a file may be a part of a Buffer, and samples an array of another realm", () => {
  const file = new Uint8Array(wav(Array(4000).fill(0.5)));
  assert.equal(readSound(Buffer.concat([Buffer.alloc(9), file]).subarray(9)).length, 4000);
  assert.equal(resample(runInNewContext("new Float32Array(4800)") as Float32Array, 48000).length, 1600);
});

test("channels are averaged, and a recorder that was stopped may state any length", () => {
  const stereo = Array.from({ length: 8000 }, (_, k) => (k % 2 ? 0.5 : 0.25));
  const found = readSound(wav(stereo, { channels: 2, declared: 0xffffffff }));
  assert.equal(found.length, 4000);
  assert.ok(found.every((sample) => sample === 0.375));
});

test("a header that was never finished is read to the end of the file", () => {
  assert.equal(readSound(wav(Array(4000).fill(0.5), { declared: 0 })).length, 4000);
});

test("of channels that cancel each other the loudest is taken", () => {
  const stereo = Array.from({ length: 8000 }, (_, k) => (k % 2 ? -1 : 0.5) * Math.sin(0.1 * Math.floor(k / 2)));
  const opposite = stereo.map((sample, k) => (k % 2 ? sample / 2 : sample));
  assert.ok(Math.max(...readSound(wav(opposite, { channels: 2 }))) > 0.49);
  assert.ok(Math.max(...readSound(wav(stereo, { channels: 2 }))) < 0.3);
});

test("nothing is to be heard in a constant", () => {
  assert.ok(isSilent(new Float32Array(4000).fill(0.05)));
  assert.ok(!isSilent(sine(440, 16000)));
});

test("NaN is silence, and a peak above 1 is scaled to 1", () => {
  const found = readSound(wav(Array.from({ length: 4000 }, (_, k) => (k ? 2 : NaN)), { code: 3, bits: 32 }));
  assert.deepEqual([...found.subarray(0, 3)], [0, 1, 1]);
});

test("files that are no sound are refused", () => {
  const text = new TextEncoder().encode("this is a text that is named speech.wav").buffer as ArrayBuffer;
  const refused: [ArrayBuffer, RegExp][] = [
    [new ArrayBuffer(0), /no WAV file/],
    [text, /no WAV file/],
    [wav([]).slice(0, 20), /no samples/],
    [wav([0.5]), /0\.000 s; expected at least 0\.2 s/],
    [wav(Array(8000).fill(0.5), { rate: 1 }), /more than 65 minutes/],
    [wav(Array(900).fill(0.5), { rate: 900 }), /900 samples per second/],
    [wav(Array(8000).fill(0.5), { rate: 0 }), /0 samples per second/],
    [wav(Array(8000).fill(0.5), { channels: 0 }), /0 channels/],
    [wav(Array(8000).fill(0.5), { code: 85 }), /kind 85/],
    [wav(Array(8000).fill(NaN), { code: 3, bits: 32 }), /only NaN/],
  ];
  for (const [bytes, message] of refused) assert.throws(() => readSound(bytes), message);
});

test("the rate of an MP3 is that of frames which follow each other, and no other file has one", () => {
  const bytes = new Uint8Array(3000);
  bytes.set([0xff, 0xe3, 0x10, 0x00], 500); // looks like a frame
  assert.equal(rateOf(bytes), 48000);
  const frames = new Uint8Array(2000);
  frames.set([..."ID3"].map((letter) => letter.charCodeAt(0)));
  frames[9] = 20; // bytes of the tag after its head
  for (const at of [30, 30 + 144]) frames.set([0xff, 0xf3, 0x48, 0xc4], at); // 32 kbit/s at 16 kHz
  assert.equal(rateOf(frames), 16000);
});

test("sound of whole numbers is refused", () => {
  assert.throws(() => resample(new Int16Array(100) as never, 48000), /no Float32Array/);
  assert.throws(() => new RunningResampler(48000).push(new Int16Array(100) as never), /no Float32Array/);
});

test("a WAV of a kind that only the browser reads is decoded by it, at its own rate", async () => {
  const rates: number[] = [];
  class Audio {
    duration = 1;
    onloadedmetadata = () => {};
    get src() {
      return "";
    }
    set src(_: string) {
      queueMicrotask(() => this.onloadedmetadata());
    }
  }
  class OfflineAudioContext {
    constructor(_channels: number, _length: number, rate: number) {
      rates.push(rate);
    }
    decodeAudioData = () => Promise.reject(new Error());
  }
  Object.assign(globalThis, { Audio, OfflineAudioContext });
  const { signal } = new AbortController();
  for (const code of [6, 7, 17]) {
    const file = new File([wav(Array(8000).fill(0.5), { code, bits: 8, rate: 11025 })], "a.wav");
    await assert.rejects(openSound(file, signal), /This browser finds no sound in a\.wav/);
  }
  assert.deepEqual(rates, [11025, 11025, 11025]);
});

test("resampling keeps what the new rate can hold, and removes the rest", () => {
  for (const rate of [8000, 22050, 44100, 48000, 44099]) {
    const found = resample(sine(1000, rate), rate);
    assert.equal(found.length, 8000);
    const expected = sine(1000, 16000);
    const errors = found.subarray(2000, 6000).map((sample, k) => Math.abs(sample - expected[2000 + k]));
    assert.ok(Math.max(...errors) < 1e-5, `${rate}: ${Math.max(...errors)}`);
  }
  const above = resample(sine(9000, 48000), 48000).subarray(2000, 6000);
  assert.ok(above.every((sample) => Math.abs(sample) < 1e-5));
});

test("the columns of a running spectrogram are those of the whole, however the sound is cut", () => {
  const samples = noise(16000);
  const mel = new Float32Array(NUM_MELS);
  let loudest = 0;
  for (let start = 0; start + 1024 <= samples.length; start += 512) {
    melPower(samples, start, mel);
    loudest = Math.max(loudest, ...mel);
  }
  const whole = logMel(samples);
  for (const piece of [1, 100, 511, 512, 1500, 16000]) {
    const running = new RunningMel(40, loudest);
    for (let start = 0; start < samples.length; start += piece) running.add(samples.subarray(start, start + piece));
    const window = running.window(0, whole.length / NUM_MELS);
    whole.forEach((value, k) => {
      const [column, band] = [Math.floor(k / NUM_MELS), k % NUM_MELS];
      assert.equal(window[band * (whole.length / NUM_MELS) + column], toFloat16(value));
    });
  }
});

test("numbers are rounded as in Python", () => {
  assert.deepEqual([0.5, 1.5, 2.5, -0.5, -1.5, 2.4, -2.6].map(round).map((value) => value + 0), [0, 2, 2, 0, -2, 2, -3]);
  const halves = [-80, -79.97, -33.3333, -1.00048828125, -0.1, -6e-5, -1e-6, 0].map(toFloat16);
  const expected = [-80, -80, -33.34375, -1, -0.0999755859375, -0.00006002187728881836, -1.0132789611816406e-6, 0];
  assert.deepEqual(halves.map((value) => value + 0), expected);
});

test("sound that arrives in pieces of any size is resampled as in one", () => {
  for (const rate of [8000, 44100, 48000]) {
    const [whole, parts] = [new RunningResampler(rate), new RunningResampler(rate)];
    const samples = sine(300, rate);
    const expected = whole.push(samples);
    const found: number[] = [];
    for (let at = 0, size = 1; at < samples.length; at += size, size = (7 * size + 3) % 999) {
      found.push(...parts.push(samples.subarray(at, at + size)));
      size ||= 1;
    }
    assert.deepEqual(found, [...expected]);
    assert.ok(expected.length > 7900 && expected.length <= 8000);
    expected.slice(100).forEach((value, k) => {
      assert.ok(Math.abs(value - 0.5 * Math.sin((2 * Math.PI * 300 * (k + 100)) / 16000)) < 2e-3);
    });
  }
  assert.throws(() => new RunningResampler(NaN), /expected the rate/);
});
