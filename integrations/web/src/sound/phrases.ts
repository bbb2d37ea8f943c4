/**
 * Voice and the ends of phrases in sound that arrives in pieces: what someone who listens nods at, as in
 * `ha2g_jax/features/phrases.py`.
 */

import { joined } from "../arrays.js";
import { round } from "../rounding.js";
import { FFT_SIZE, HOP_LENGTH, melPower, NUM_MELS, SAMPLE_RATE } from "./mel.js";
import { melFrequencies } from "./spectrum.js";

const LEAST_PHRASE = 1; // seconds of the shortest phrase whose end counts
const LEAST_VOICE = 0.2; // seconds of voice that are no click
const PAUSE_COLUMNS = 11; // without voice that end a phrase, and of the end of a word that is too quiet to be voice
const VOICE_HZ = [150, 4000];
const [LEAST_DB, FIRST_PEAK_DB] = [-68, -20]; // of a column; digital silence has the first
const [ABOVE_FLOOR_DB, BELOW_PEAK_DB] = [6, 24]; // of the least voice
const DROP_DB = 8; // from the mean level of a phrase to that of a pause
const FLOOR_COLUMNS = 94; // three seconds
const FALL_DB = 1; // of the peak per second of voice
const COLUMN = HOP_LENGTH / SAMPLE_RATE; // seconds
const CENTRES = melFrequencies(NUM_MELS + 2, SAMPLE_RATE / 2).slice(1, -1);
const [FIRST, END] = VOICE_HZ.map((hertz) => CENTRES.findIndex((centre) => centre >= hertz));

/** Voice and the ends of phrases of sound that arrives in pieces, in memory that does not grow. */
export class Phrases {
  /** Times in seconds of the ends of phrases of at least a second, which a pause of 0.3 s has followed. */
  ends: number[] = [];
  private numColumns: number;
  private samples: Float32Array; // from half a column before the next one on
  private readonly isVoice: boolean[]; // the latest column last
  private readonly levels: number[];
  private peak = FIRST_PEAK_DB;
  private first = 0; // column of the phrase with voice
  private last = 0;
  private numVoice = 0; // of these columns
  private voiceSum = 0; // of the levels of the voice
  private pauseSum = 0; // since the last of it

  /**
   * @param seconds - time for which voice and ends are remembered.
   * @param numSamples - samples of silence before the first; the result is that of adding them.
   */
  constructor(
    private readonly seconds: number,
    numSamples: number,
  ) {
    this.numColumns = Math.floor(numSamples / HOP_LENGTH);
    this.samples = new Float32Array((numSamples % HOP_LENGTH) + HOP_LENGTH);
    this.isVoice = new Array(Math.ceil(seconds / COLUMN)).fill(false);
    this.levels = new Array(FLOOR_COLUMNS).fill(LEAST_DB);
  }

  /** Adds samples at 16 kHz to the end. */
  add(samples: Float32Array): void {
    const known = joined([this.samples, samples]);
    let start = 0;
    for (; start + FFT_SIZE <= known.length; start += HOP_LENGTH) this.addColumn(known, start);
    this.samples = known.slice(start);
  }

  /** Returns whether there is voice, and not a click, between two times in seconds that are remembered. */
  hasVoice(start: number, end: number): boolean {
    const first = this.isVoice.length - this.numColumns;
    const [from, to] = [start, end].map((time) => Math.max(first + round(time / COLUMN), 0));
    return this.isVoice.slice(from, to).filter(Boolean).length * COLUMN >= LEAST_VOICE;
  }

  private addColumn(samples: Float32Array, start: number): void {
    const mel = new Float32Array(NUM_MELS);
    melPower(samples, start, mel);
    const power = mel.subarray(FIRST, END).reduce((sum, value) => sum + value, 0) / (END - FIRST);
    const level = Math.max(10 * Math.log10(Math.max(power, 1e-9)), LEAST_DB);
    const isVoice = level > Math.max(Math.min(...this.levels) + ABOVE_FLOOR_DB, this.peak - BELOW_PEAK_DB);
    this.levels.shift();
    this.levels.push(level);
    this.isVoice.shift();
    this.isVoice.push(isVoice);
    if (isVoice) {
      this.peak = Math.max(level, this.peak - FALL_DB * COLUMN);
      if (!this.numVoice) this.first = this.numColumns;
      this.last = this.numColumns;
      this.numVoice++;
      this.voiceSum += level;
      this.pauseSum = 0;
    } else if (this.numVoice) {
      this.pauseSum += level;
      if (this.numColumns - this.last === PAUSE_COLUMNS) this.endPhrase();
    }
    this.numColumns++;
    const earliest = this.numColumns * COLUMN - this.seconds;
    this.ends = this.ends.filter((end) => end > earliest);
  }

  private endPhrase(): void {
    const drop = this.voiceSum / this.numVoice - this.pauseSum / PAUSE_COLUMNS;
    if ((this.last + 1 - this.first) * COLUMN >= LEAST_PHRASE && drop > DROP_DB) {
      this.ends.push((this.last + 0.5) * COLUMN);
    }
    [this.numVoice, this.voiceSum, this.pauseSum] = [0, 0, 0];
  }
}
