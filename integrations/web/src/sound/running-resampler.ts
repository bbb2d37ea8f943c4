/** Resampling to 16 kHz of sound that arrives in pieces. */

import { joined } from "../arrays.js";
import { checkArray } from "./speech.js";

const NEW_RATE = 16000;
const ZEROS = 16; // zero crossings of the filter on each side
const STEPS = 512; // values of the filter between two zero crossings

/** Filters with a windowed sinc; what comes out does not depend on how the sound is cut into pieces. */
export class RunningResampler {
  private readonly step: number;
  private readonly cutoff: number;
  private readonly filter: Float32Array;
  /** Samples from number `first` on that are still needed. */
  private kept = new Float32Array(0);
  private first = 0;
  private count = 0;

  /** @param rate - samples per second of what arrives. */
  constructor(rate: number) {
    if (!(rate > 0)) throw new Error(`${rate} samples per second; expected the rate of the sound`);
    this.step = rate / NEW_RATE;
    this.cutoff = Math.min(1, NEW_RATE / rate);
    this.filter = Float32Array.from({ length: ZEROS * STEPS + 2 }, (_, i) => {
      const x = i / STEPS;
      const window = x < ZEROS ? 0.5 + 0.5 * Math.cos((Math.PI * x) / ZEROS) : 0;
      return window * (x ? Math.sin(Math.PI * x) / (Math.PI * x) : 1);
    });
  }

  /** Takes the next samples, and returns those at 16 kHz whose surroundings are known. */
  push(samples: Float32Array): Float32Array {
    checkArray(samples);
    const all = joined([this.kept, samples]);
    const reach = ZEROS / this.cutoff;
    const made: number[] = [];
    for (; this.count * this.step + reach < this.first + all.length; this.count++) {
      made.push(this.at(this.count * this.step - this.first, reach, all));
    }
    const needed = Math.max(Math.floor(this.count * this.step - reach) - this.first, 0);
    this.kept = all.slice(needed);
    this.first += needed;
    return Float32Array.from(made);
  }

  private at(place: number, reach: number, samples: Float32Array): number {
    let sum = 0;
    for (let i = Math.max(Math.ceil(place - reach), 0); i <= place + reach; i++) {
      sum += samples[i] * this.filter[Math.round(Math.abs(place - i) * this.cutoff * STEPS)];
    }
    return sum * this.cutoff;
  }
}
