/** Reader of WAV files. */

import { bytesOf } from "../formats/bytes.js";
import { SAMPLE_RATE } from "./mel.js";
import { resample } from "./resample.js";
import { checkLength, finite, isCancelled } from "./speech.js";

const PCM = 1;
const FLOAT = 3;
const EXTENSIBLE = 0xfffe;
const MOST_CHANNELS = 64;

interface Format {
  code: number;
  channels: number;
  rate: number;
  /** Bytes of a sample of one channel. */
  size: number;
}

/**
 * Reads a WAV file as mono samples at 16 kHz; channels are averaged, or the loudest is taken if they cancel each other.
 * Samples that are not finite become 0, and sound with a peak above 1 is scaled to a peak of 1.
 *
 * @param bytes - contents of the file.
 * @returns (samples,) at 16 kHz.
 * @throws Error if it is no WAV file of PCM or floating-point samples, shorter than 0.2 s or longer than 65 minutes.
 */
export function readSound(bytes: ArrayBuffer | Uint8Array): Float32Array {
  const { buffer, byteOffset, byteLength } = bytesOf(bytes);
  const view = new DataView(buffer, byteOffset, byteLength);
  const { format, start, end } = readChunks(view);
  const numSamples = Math.floor((end - start) / (format.size * format.channels));
  checkLength(numSamples, format.rate);
  const samples = resample(finite(mix(view, format, start, numSamples)), format.rate, SAMPLE_RATE);
  const peak = samples.reduce((most, sample) => Math.max(most, Math.abs(sample)), 0);
  return peak > 1 ? samples.map((sample) => sample / peak) : samples;
}

/** Returns the format of the samples, and where they start and end. */
function readChunks(view: DataView): { format: Format; start: number; end: number } {
  const total = view.byteLength;
  if (total < 12 || text(view, 0) !== "RIFF" || text(view, 8) !== "WAVE") throw new Error("the file is no WAV file");
  let format: Format | undefined;
  for (let at = 12; at + 8 <= total; ) {
    const size = view.getUint32(at + 4, true);
    const start = at + 8;
    if (text(view, at) === "fmt " && start + 16 <= total) format = readFormat(view, start);
    if (text(view, at) === "data") {
      if (!format) throw new Error("the WAV file does not say of what kind its samples are");
      return { format, start, end: Math.min(start + (size || total), total) }; // a recorder that crashes states any size
    }
    at = start + size + (size % 2);
  }
  throw new Error("the WAV file has no samples");
}

function readFormat(view: DataView, at: number): Format {
  const extended = view.getUint16(at, true) === EXTENSIBLE && at + 26 <= view.byteLength;
  const code = view.getUint16(extended ? at + 24 : at, true);
  const channels = view.getUint16(at + 2, true);
  const rate = view.getUint32(at + 4, true);
  const size = view.getUint16(at + 14, true) / 8;
  if (!(channels >= 1 && channels <= MOST_CHANNELS)) {
    throw new Error(`the WAV file has ${channels} channels; expected 1 to ${MOST_CHANNELS}`);
  }
  if (rate === 0) throw new Error("the WAV file has 0 samples per second");
  const isKnown = (code === PCM && [1, 2, 3, 4].includes(size)) || (code === FLOAT && [4, 8].includes(size));
  if (!isKnown) {
    throw new Error(`the WAV file has samples of kind ${code} with ${8 * size} bits; expected PCM or floating point`);
  }
  return { code, channels, rate, size };
}

/** Returns the mean of the channels, (numSamples,), added in float32 as NumPy does, or the loudest of those that cancel. */
function mix(view: DataView, format: Format, start: number, numSamples: number): Float32Array {
  const { channels, size } = format;
  const read = reader(view, format);
  const mixed = new Float32Array(numSamples);
  const powers: number[] = Array(channels).fill(0);
  let power = 0;
  for (let k = 0, at = start; k < numSamples; k++) {
    let sum = 0;
    for (let channel = 0; channel < channels; channel++, at += size) {
      const sample = Math.fround(read(at));
      sum = Math.fround(sum + sample);
      powers[channel] += sample * sample;
    }
    mixed[k] = sum / channels;
    power += mixed[k] * mixed[k];
  }
  if (!isCancelled(power, powers)) return mixed;
  const loudest = powers.indexOf(Math.max(...powers));
  return mixed.map((_, k) => read(start + (k * channels + loudest) * size));
}

/** Returns a function from a place to the sample there. */
function reader(view: DataView, { code, size }: Format): (at: number) => number {
  if (code === FLOAT) return size === 4 ? (at) => view.getFloat32(at, true) : (at) => view.getFloat64(at, true);
  if (size === 1) return (at) => (view.getUint8(at) - 128) / 128;
  if (size === 2) return (at) => view.getInt16(at, true) / 2 ** 15;
  if (size === 3) return (at) => (view.getUint16(at, true) + view.getInt8(at + 2) * 2 ** 16) / 2 ** 23;
  return (at) => view.getInt32(at, true) / 2 ** 31;
}

function text(view: DataView, at: number): string {
  return String.fromCharCode(...[0, 1, 2, 3].map((k) => view.getUint8(at + k)));
}
