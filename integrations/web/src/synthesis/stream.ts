/** Motion from speech that arrives in pieces, while someone speaks, as in `ha2g_jax/synthesis/stream.py`. */

import { checkEnergy } from "../motion/control/effects.js";
import { EASE_SECONDS, Ramp, RunningControls } from "../motion/control/running.js";
import { Idle } from "../motion/idle.js";
import { type Numbers, unit } from "../motion/rotations.js";
import { slerp } from "../motion/sphere.js";
import { round } from "../rounding.js";
import { FLOOR_DB, NUM_MELS, SAMPLE_RATE, windowColumn, windowColumns } from "../sound/mel.js";
import { RunningMel } from "../sound/running-mel.js";
import { hideUnheard } from "../sound/unheard.js";
import { checkNames, HOP, LOOK_AHEAD, type StreamChange, type StreamOptions } from "./options.js";
import type { Sampler } from "./sampler.js";
import { chooseStyle, chooseTake } from "./style.js";
import { RunningJoin } from "./windows.js";

const PAUSE_SECONDS = 0.3; // after the last sound, and before the hands begin to rest
const REST_WINDOWS = 3; // of silence until a model is at rest

/**
 * Motion that follows speech, and rests where no sound is near.
 *
 * Frame k shows the time k / fps. Frames are made `hop` at a time: those of one hop use the speech up to `lookAhead`
 * frames after the last of them, and no later sample. A call of `feed`, `flush` or `skip` must be done before the next.
 */
export class Stream {
  private readonly lookAhead: number;
  private readonly hop: number;
  private readonly seed: number;
  private readonly join: RunningJoin;
  private readonly mel: RunningMel;
  private readonly controls: RunningControls;
  private readonly idle: Idle;
  private readonly startPose: Float32Array;
  private readonly styleRamp: Ramp;
  private readonly restRamp: Promise<Ramp>;
  private weightRamp: Ramp | undefined; // of the motion, from rest; begins at the first frame
  private style: Float32Array;
  private rest: Promise<Numbers>; // pose of the present style
  private energy: number;
  private muted: boolean;
  private past: Float32Array; // the frames before the next new one, from the start of its window on
  private held: Float32Array = new Float32Array(0); // frames that are not final
  private numSamples = 0;
  private numRuns = 0;
  private numReturned = 0;
  private isEnded = false;

  constructor(
    private readonly sampler: Sampler,
    options: StreamOptions = {},
  ) {
    checkNames(options, "stream");
    const { lookAhead = LOOK_AHEAD, hop = HOP, seed = 0, energy = 1, muted = false, reference } = options;
    const { num_frames, num_seed_frames, fps, has_hidden_ends, skeleton, seed_poses } = sampler.description;
    check(num_frames, num_seed_frames, lookAhead, hop, reference);
    checkEnergy(energy);
    [this.lookAhead, this.hop, this.seed, this.energy, this.muted] = [lookAhead, hop, seed, energy, muted];
    this.style = chooseStyle(sampler.description, options, seed).values;
    this.styleRamp = new Ramp(this.style, fps);
    this.controls = new RunningControls(skeleton, fps, energy);
    this.idle = new Idle(skeleton, seed);
    let first = num_seed_frames;
    // Without hidden ends the window ends where the speech that is heard ends.
    if (!has_hidden_ends) first = Math.min(Math.max(first, num_frames - lookAhead - hop + 1), num_frames - hop);
    this.join = new RunningJoin(num_frames, num_seed_frames, hop, first, sampler.size);
    const kept = windowColumns(num_frames + lookAhead, fps) + windowColumn(PAUSE_SECONDS, 1) + 2;
    this.mel = new RunningMel(kept, reference);
    const pose = seed_poses[chooseTake(sampler.description, seed).seed_pose];
    this.startPose = Float32Array.from(pose.flat(2));
    this.rest = this.findRest();
    this.restRamp = this.rest.then((rest) => new Ramp(rest, fps));
    this.restRamp.catch(() => undefined); // `run` has the error
    const still = Array.from({ length: Math.max(first - pose.length, 0) }, () => pose[0]);
    this.past = Float32Array.from([...still, ...pose].flat(2));
  }

  /** Seconds from a moment of the speech to its frame at most, without the time of the computation. */
  get latency(): number {
    return Math.max(this.lookAhead + this.hop, 1.5) / this.sampler.description.fps;
  }

  /** Changes what is given with the next frames, within half a second; a part of a style replaces all of the style. */
  change({ energy = this.energy, muted = this.muted, ...style }: StreamChange): void {
    checkEnergy(energy);
    if (Object.values(style).some((part) => part !== undefined)) {
      this.style = chooseStyle(this.sampler.description, style, this.seed).values;
      this.rest = this.findRest();
      this.rest.catch(() => undefined); // `run` has the error
    }
    [this.energy, this.muted] = [energy, muted];
  }

  /**
   * Takes the next samples, and returns the frames that became final.
   *
   * @param samples - mono samples at 16 kHz, any number of them. Those that are not finite are taken as silence, those
   *   beyond -1 and 1 are clipped.
   * @returns (n, bones, 3) unit vectors, the frames after those that were returned before; n may be 0.
   */
  async feed(samples: Float32Array): Promise<Float32Array> {
    this.checkOpen();
    const heard = samples.map((sample) => (Number.isFinite(sample) ? Math.min(Math.max(sample, -1), 1) : 0));
    const frames = [this.held];
    let start = 0;
    for (let end = this.needed(); end <= heard.length; end = start + this.needed()) {
      this.hear(heard.subarray(start, end));
      frames.push((await this.run()).subarray(0, this.hop * this.sampler.size));
      start = end;
    }
    this.hear(heard.subarray(start));
    // A motion of the speech so far has this many frames; later ones wait, as the speech may end here.
    return this.finished(frames, round((this.numSamples / SAMPLE_RATE) * this.sampler.description.fps));
  }

  /**
   * Ends the stream, and returns the rest of the frames; after the end of the speech there is silence.
   *
   * @returns (n, bones, 3) unit vectors. All frames of the stream are round(duration x fps), at least 1.
   */
  async flush(): Promise<Float32Array> {
    this.checkOpen();
    this.isEnded = true;
    const { size, description } = this.sampler;
    const count = Math.max(1, round((this.numSamples / SAMPLE_RATE) * description.fps));
    const frames = [this.held];
    let missing = count - this.numRuns * this.hop;
    while (missing > 0) {
      const shown = await this.run();
      const isLast = missing * size <= shown.length;
      frames.push(shown.subarray(0, (isLast ? missing : this.hop) * size));
      missing -= isLast ? missing : this.hop;
    }
    return this.finished(frames, count);
  }

  /** Generates the next window, and returns the frames from its first new one on. */
  private async run(): Promise<Float32Array> {
    const { description, size } = this.sampler;
    const { num_frames, num_seed_frames, fps, audio } = description;
    const { first } = this.join;
    const style = Float32Array.from(this.styleRamp.step(this.style, this.hop));
    const pose = unit((await this.restRamp).step(await this.rest, this.hop), 3);
    const start = this.numRuns * this.hop - first;
    const rest = this.idle.frames(pose, start, num_frames, fps);
    const weights = this.weights();
    let window: Float32Array;
    if (weights.some(Boolean)) {
      const mel = this.mel.window(windowColumn(start, fps), audio.columns);
      if (!this.isEnded) hideUnheard(mel, start, this.heard() - start, fps);
      window = await this.sampler.run(mel, style, this.past.slice(0, num_seed_frames * size), this.seed, start);
    } else {
      window = Float32Array.from(rest);
    }
    const rested = withRest(window, rest, weights);
    if (first) {
      const latest = new Float32Array(this.past.length + this.hop * size);
      latest.set(this.past);
      latest.set(rested.subarray(first * size, (first + this.hop) * size), this.past.length);
      this.past = latest.slice(-first * size);
    } else {
      this.past = rested.slice(this.hop * size);
    }
    this.numRuns++;
    return withRest(this.join.add(window), rest.subarray(first * size), weights.subarray(first));
  }

  /**
   * Returns the weights (N) of the generator's motion in the next window: 1 near sound, 0 at rest.
   *
   * Frames after the next `hop` ones have the last weight; they are generated again, or the speech has ended.
   */
  private weights(): Numbers {
    const { fps, num_frames } = this.sampler.description;
    // What would follow the speech is not silence in it.
    const last = this.isEnded ? Math.max(1, round((this.numSamples / SAMPLE_RATE) * fps)) - 1 : Infinity;
    const weights = new Float64Array(num_frames);
    for (let k = 0; k < this.hop; k++) {
      const frame = Math.min(this.numRuns * this.hop + k, last);
      const [from, to] = [-PAUSE_SECONDS, EASE_SECONDS].map((seconds) => windowColumn(frame + seconds * fps, fps));
      const target = [Number(this.mel.hasSound(from, to))];
      this.weightRamp ??= new Ramp(target, fps);
      weights.fill(this.weightRamp.step(target)[0], k && this.join.first + k);
    }
    return weights;
  }

  /** Returns the pose (bones, 3) in which the model rests with the present style: where silence leads it. */
  private async findRest(): Promise<Numbers> {
    const { size, description } = this.sampler;
    const silence = new Float32Array(NUM_MELS * description.audio.columns).fill(FLOOR_DB);
    const { style, seed } = this;
    const { num_frames, num_seed_frames } = description;
    let window = this.startPose;
    for (let k = 0; k < REST_WINDOWS; k++) {
      const pose = window.slice(-num_seed_frames * size);
      window = await this.sampler.run(silence, style, pose, seed, k * (num_frames - num_seed_frames));
    }
    const mean = new Float64Array(size);
    window.forEach((value, k) => (mean[k % size] += value));
    return unit(mean, 3);
  }

  /** Returns the number of frames whose time must have passed before the next run. */
  private heard(): number {
    return (this.numRuns + 1) * this.hop - 1 + this.lookAhead;
  }

  /** Returns the number of samples that the next run still needs. */
  private needed(): number {
    return Math.floor((this.heard() * SAMPLE_RATE) / this.sampler.description.fps) - this.numSamples;
  }

  private hear(samples: Float32Array): void {
    this.mel.add(samples);
    this.numSamples += samples.length;
  }

  /** Returns the frames before frame `count` of the motion, with their controls, and holds the others. */
  private finished(frames: Float32Array[], count: number): Float32Array {
    const { size } = this.sampler;
    const joined = new Float32Array(frames.reduce((length, part) => length + part.length, 0));
    let at = 0;
    for (const part of frames) {
      joined.set(part, at);
      at += part.length;
    }
    const final = Math.max(count - this.numReturned, 0) * size;
    this.held = joined.slice(final);
    const returned = this.controls.apply(joined.subarray(0, final), this.energy, this.muted);
    this.numReturned += returned.length / size;
    return returned;
  }

  private checkOpen(): void {
    if (this.isEnded) throw new Error("the stream has ended; begin another one with Gesturer.stream");
  }
}

/** Returns a motion (T, bones, 3) with weights (T), 0 for the motion `rest` (T, bones, 3). */
function withRest(motion: Float32Array, rest: Numbers, weights: Numbers): Float32Array {
  const result = motion.slice();
  const size = motion.length / weights.length;
  weights.forEach((weight, frame) => {
    const [at, end] = [frame * size, (frame + 1) * size];
    if (weight < 1) result.set(slerp(rest.subarray(at, end), motion.subarray(at, end), weight), at);
  });
  return result;
}

/** Checks the options of a stream but style and energy. */
function check(window: number, overlap: number, lookAhead: number, hop: number, reference: number | undefined): void {
  if (!(Number.isInteger(lookAhead) && lookAhead >= 0 && lookAhead <= window)) {
    throw new Error(`the look-ahead is ${lookAhead}; expected 0 to ${window} frames, the window of the model`);
  }
  const longest = window - 2 * overlap;
  if (!(Number.isInteger(hop) && ((hop >= 1 && hop <= longest) || hop === window - overlap))) {
    throw new Error(`the hop is ${hop}; expected 1 to ${longest} frames, or ${window - overlap}`);
  }
  if (reference !== undefined && !(reference >= 0 && reference < Infinity)) {
    throw new Error(`the mel power of 0 dB is ${reference}; expected a number from 0 on`);
  }
}
