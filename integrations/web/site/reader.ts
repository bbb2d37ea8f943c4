/** The worker that reads sound, so that a long file does not hold up the page. */

import { resample } from "../src/sound/resample.js";
import { isCancelled } from "../src/sound/speech.js";
import { readSound } from "../src/sound/wav.js";
import { peaksOf } from "./peaks.js";

/** A WAV file, or channels that the browser has decoded. */
export type Given = { bytes: ArrayBuffer } | { channels: Float32Array[]; rate: number };

/** Mono samples at 16 kHz and their waveform, or what is wrong with the file. */
export type Found = { samples: Float32Array<ArrayBuffer>; peaks: Uint8Array } | { error: string };

self.onmessage = ({ data }: MessageEvent<Given>) => {
  try {
    const samples = "bytes" in data ? readSound(data.bytes) : resample(mean(data.channels), data.rate);
    const found = { samples, peaks: peaksOf(samples, 16000) };
    self.postMessage(found, { transfer: [samples.buffer] });
  } catch (error) {
    self.postMessage({ error: error instanceof Error ? error.message : String(error) });
  }
};

function mean(channels: Float32Array[]): Float32Array {
  if (channels.length === 1) return channels[0];
  const power = (samples: Float32Array) => samples.reduce((sum, sample) => sum + sample * sample, 0);
  const mixed = channels[0].map((_, i) => channels.reduce((sum, channel) => sum + channel[i], 0) / channels.length);
  const powers = channels.map(power);
  return isCancelled(power(mixed), powers) ? channels[powers.indexOf(Math.max(...powers))] : mixed;
}
