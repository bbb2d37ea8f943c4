/** Sound of a file: the samples that the model hears, and what the page plays. */

import { rateOf } from "./containers.js";
import { fileOf } from "./elements.js";
import type { Found, Given } from "./reader.js";

export const RATE = 16000;
const MAX_BYTES = 512 * 2 ** 20; // of a file
const MAX_SECONDS = 20 * 60; // two channels of it at 48 kHz have 460 MB
const MAX_BYTES_OF_UNKNOWN_LENGTH = 32 * 2 ** 20;

export interface Sound {
  /** Name of the file. */
  name: string;
  /** Mono samples at 16 kHz. */
  samples: Float32Array<ArrayBuffer>;
  /** Waveform, see peaks.ts. */
  peaks: Uint8Array;
  /** What is played. */
  content: Blob;
}

/**
 * Reads a file: a WAV of PCM or floating point by the reader of this package, everything else by the browser.
 *
 * @param signal - ends the reading.
 * @throws Error with a sentence for people.
 */
export async function openSound(file: File, signal: AbortSignal): Promise<Sound> {
  if (!file.size) throw new Error(`${file.name} is empty.`);
  if (file.size > MAX_BYTES) throw new Error(`${file.name} is larger than ${MAX_BYTES / 2 ** 20} MiB.`);
  const head = new DataView(await file.slice(0, 64).arrayBuffer());
  const start = new TextDecoder().decode(head).trimStart().toLowerCase();
  if (start.startsWith("version https://git-lfs")) {
    throw new Error(`${file.name} is a pointer of Git LFS, not the file; run git lfs pull.`);
  }
  if (/^<(!doctype )?html/.test(start)) throw new Error(`${file.name} is a web page, not a sound; download it again.`);
  if (isPlainWave(head)) {
    const stated = statedSeconds(head, file.size); // a little too long where the file has more than sound
    if (stated > 1.1 * MAX_SECONDS) checkSeconds(file.name, stated);
    return { name: file.name, content: file, ...(await read(file.name, { bytes: await bytesOf(file) }, signal)) };
  }
  await checkPlayable(file, signal);
  const bytes = await bytesOf(file);
  const context = new OfflineAudioContext(1, 1, rateOf(new Uint8Array(bytes)));
  const buffer = await context.decodeAudioData(bytes).catch(() => {
    throw new Error(`This browser finds no sound in ${file.name}.`);
  });
  signal.throwIfAborted();
  checkSeconds(file.name, buffer.duration);
  const channels = Array.from({ length: buffer.numberOfChannels }, (_, i) => buffer.getChannelData(i).slice());
  return { name: file.name, content: file, ...(await read(file.name, { channels, rate: buffer.sampleRate }, signal)) };
}

/** Returns 16 kHz samples as a WAV file of 16 bits. */
export function waveOf(samples: Float32Array): Blob {
  const head = new DataView(new ArrayBuffer(44));
  const texts = ["RIFF", "WAVE", "fmt ", "data"];
  [0, 8, 12, 36].forEach((at, i) => [...texts[i]].forEach((letter, k) => head.setUint8(at + k, letter.charCodeAt(0))));
  const size = 2 * samples.length;
  [[4, 36 + size], [16, 16], [24, RATE], [28, 2 * RATE], [40, size]].forEach(([at, n]) => head.setUint32(at, n, true));
  [[20, 1], [22, 1], [32, 2], [34, 16]].forEach(([at, n]) => head.setUint16(at, n, true));
  const pcm = Int16Array.from(samples, (sample) => Math.max(-32768, Math.min(32767, Math.round(32768 * sample))));
  return new Blob([head, pcm], { type: "audio/wav" });
}

async function bytesOf(file: File): Promise<ArrayBuffer> {
  return file.arrayBuffer().catch(() => {
    throw new Error(`${file.name} cannot be read; it may have been moved or changed.`);
  });
}

/** Returns whether a file is a WAV of PCM or floating point, or one that does not state its kind at its start. */
function isPlainWave(head: DataView): boolean {
  const text = (at: number) => String.fromCharCode(...[0, 1, 2, 3].map((i) => head.getUint8(at + i)));
  if (head.byteLength < 12 || text(0) !== "RIFF" || text(8) !== "WAVE") return false;
  return head.byteLength < 22 || text(12) !== "fmt " || [1, 3, 0xfffe].includes(head.getUint16(20, true));
}

/** Returns the length of a WAV file by its size and the kind of samples that it states at its start, 0 if not there. */
function statedSeconds(head: DataView, size: number): number {
  if (head.byteLength < 36 || head.getUint32(12) !== 0x666d7420) return 0;
  return (size - 44) / Math.max(head.getUint32(24, true) * head.getUint16(32, true), 1000);
}

function checkSeconds(name: string, seconds: number): void {
  if (seconds <= MAX_SECONDS) return;
  throw new Error(`${name} lasts ${Math.ceil(seconds / 6) / 10} minutes; this page takes up to ${MAX_SECONDS / 60}.`);
}

/** Checks that the browser plays a file, and its length before it is decoded into memory. */
async function checkPlayable(file: File, signal: AbortSignal): Promise<void> {
  const audio = new Audio();
  audio.preload = "metadata";
  audio.src = URL.createObjectURL(file);
  const found = await new Promise<boolean>((resolve) => {
    audio.onloadedmetadata = () => resolve(true);
    audio.onerror = () => resolve(false);
    signal.addEventListener("abort", () => resolve(false));
  });
  const { duration } = audio;
  URL.revokeObjectURL(audio.src);
  signal.throwIfAborted();
  if (!found) throw new Error(`This browser finds no sound in ${file.name}.`);
  if (Number.isFinite(duration)) checkSeconds(file.name, duration);
  else if (file.size > MAX_BYTES_OF_UNKNOWN_LENGTH) {
    throw new Error(`${file.name} is large and does not say how long it is.`);
  }
}

/** Reads samples in a worker. */
async function read(name: string, given: Given, signal: AbortSignal) {
  const worker = new Worker(fileOf("reader.js"), { type: "module" });
  try {
    const found = await new Promise<Found>((resolve, reject) => {
      worker.onmessage = ({ data }: MessageEvent<Found>) => resolve(data);
      worker.onerror = () => resolve({ error: "there is not enough memory" });
      signal.addEventListener("abort", () => reject(signal.reason));
      worker.postMessage(given, "bytes" in given ? [given.bytes] : given.channels.map((channel) => channel.buffer));
    });
    if ("error" in found) throw new Error(`${name} cannot be used: ${found.error}`);
    if (!found.samples.length) throw new Error(`${name} has no sound.`);
    checkSeconds(name, found.samples.length / RATE);
    return found;
  } finally {
    worker.terminate();
  }
}
