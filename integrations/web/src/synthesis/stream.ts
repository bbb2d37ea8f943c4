/** Motion from speech that arrives in pieces, as in `synthesis/running_motion.py` and `stream.py` of `ha2g_jax`. */

import { joined, rowsOf } from "../arrays.js";
import { checkEnergy } from "../motion/control/effects.js";
import { EASE_SECONDS, Ramp, RunningControls } from "../motion/control/running.js";
import { RunningCues } from "../motion/cues.js";
import { Idle } from "../motion/idle.js";
import { minimumJerk } from "../motion/minimum-jerk.js";
import { type Numbers, norms, unit } from "../motion/rotations.js";
import { slerp } from "../motion/sphere.js";
import { ATTENTION, nodDepth, RunningStates, type State } from "../motion/states.js";
import { round } from "../rounding.js";
import { FLOOR_DB, NUM_MELS, SAMPLE_RATE, windowColumn, windowColumns } from "../sound/mel.js";
import { Phrases } from "../sound/phrases.js";
import { RunningMel } from "../sound/running-mel.js";
import { hideUnheard } from "../sound/unheard.js";
import { checkMuted, checkNames, HOP, LOOK_AHEAD, type StreamChange, type StreamOptions } from "./options.js";
import type { Sampler } from "./sampler.js";
import { chooseStyle, chooseTake } from "./style.js";
import { RunningJoin } from "./windows.js";

const PAUSE_SECONDS = 0.3; // after the last sound, and before the hands begin to rest
const REST_WINDOWS = 3; // of silence until a model is at rest
const REMEMBERED_SECONDS = 60; // of returned frames, to which `clear` can go back
const MEAN_SHARE = 0.6; // of the mean pose in the seed pose of a model that samples, see `running_generator.py`

/** A frame before its controls, what its time has of the agent's speech, and what it owes to the other. */
interface Frame {
  pose: Float32Array;
  weight: number;
  isAddressed: boolean;
  nod: number;
}

/** What changes the frames that are returned. */
interface Layers {
  controls: RunningControls;
  states: RunningStates;
  cues: RunningCues;
}

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
  private readonly idle: Idle;
  private layers: Layers;
  private phrases: Phrases | undefined; // of the other; begin with the first samples of the other
  private readonly startPose: Float32Array;
  private readonly styleRamp: Ramp;
  private readonly restRamp: Promise<Ramp>;
  private weightRamp: Ramp | undefined; // of the motion, from rest; begins at the first frame
  private style: Float32Array;
  private rest: Promise<Numbers>; // pose of the present style
  private energy: number;
  private muted: boolean;
  private past: Float32Array; // the frames before the next new one, from the start of its window on
  private held: Frame[] = []; // frames that are not final
  private expected: Float32Array[]; // poses after those that were made, as far as they are known
  private readonly recent: { pose: Float32Array; layers: Layers }[]; // returned frames, and the layers before each
  private dropped: Float32Array[] = []; // poses that a clear has dropped, from number `firstDropped` on
  private firstDropped = 0;
  private numSamples = 0;
  private numMade = 0;
  private numReturned = 0;
  private isEnded = false;

  constructor(
    private readonly sampler: Sampler,
    options: StreamOptions = {},
  ) {
    checkNames(options, "stream");
    const { lookAhead = LOOK_AHEAD, hop = HOP, seed = 0, energy = 1, muted = false, state = "auto", reference } = options;
    const { num_frames, num_seed_frames, fps, has_hidden_ends, skeleton, seed_poses } = sampler.description;
    check(num_frames, num_seed_frames, lookAhead, hop, reference);
    checkEnergy(energy);
    checkMuted(muted);
    [this.lookAhead, this.hop, this.seed, this.energy, this.muted] = [lookAhead, hop, seed, energy, muted];
    this.style = chooseStyle(sampler.description, options, seed).values;
    this.styleRamp = new Ramp(this.style, fps);
    this.idle = new Idle(skeleton, seed);
    const controls = new RunningControls(skeleton, fps, energy);
    const states = new RunningStates(skeleton, this.idle, fps, seed);
    this.layers = { controls, states, cues: new RunningCues(sampler.description) };
    states.state = state;
    let first = num_seed_frames;
    // Without hidden ends the window ends where the speech that is heard ends.
    if (!has_hidden_ends) first = Math.min(Math.max(first, num_frames - lookAhead - hop + 1), num_frames - hop);
    this.join = new RunningJoin(num_frames, num_seed_frames, hop, first, sampler.size, lookAhead);
    const kept = windowColumns(num_frames + lookAhead, fps) + windowColumn(PAUSE_SECONDS, 1) + 2;
    this.mel = new RunningMel(kept, reference);
    const pose = seed_poses[chooseTake(sampler.description, seed).seed_pose];
    this.startPose = Float32Array.from(pose.flat(2));
    this.rest = this.findRest();
    this.restRamp = this.rest.then((rest) => new Ramp(rest, fps));
    this.restRamp.catch(() => undefined); // `run` has the error
    const still = Array.from({ length: Math.max(first - pose.length, 0) }, () => pose[0]);
    this.past = Float32Array.from([...still, ...pose].flat(2));
    const poses = rowsOf(this.past, sampler.size);
    this.recent = poses.slice(0, this.join.first).map((pose) => ({ pose, layers: this.layers }));
    this.expected = poses.slice(this.join.first);
  }

  /** Seconds from a moment of the speech to its frame at most, without the time of the computation. */
  get latency(): number {
    return Math.max(this.lookAhead + this.hop, 1.5) / this.sampler.description.fps;
  }

  /** What the body does where the agent does not speak; "think" becomes "auto" with the next speech. */
  get state(): State {
    return this.layers.states.state;
  }

  /** Changes what is given with the next frames, within half a second; a part of a style replaces all of the style. */
  change({ energy = this.energy, muted = this.muted, state = this.state, ...style }: StreamChange): void {
    checkEnergy(energy);
    checkMuted(muted);
    if (Object.values(style).some((part) => part !== undefined)) {
      this.style = chooseStyle(this.sampler.description, style, this.seed).values;
      this.rest = this.findRest();
      this.rest.catch(() => undefined); // `run` has the error
    }
    [this.energy, this.muted, this.layers.states.state] = [energy, muted, state];
  }

  /** Makes a gesture whose stroke peaks at a time of the motion in seconds, by default as soon as possible. */
  cue(name: string, at?: number): void {
    this.layers.cues.add(name, at);
  }

  /**
   * Drops speech that shall not be shown, and cues that have not begun: the motion goes on from the pose of the frame
   * before, and within half a second it is that of a stream that never heard the speech before.
   *
   * @param frame - first frame that shall not be shown, one of the last minute; the next sample is heard at its time.
   *   Without it, the agent's sound whose frames were not returned becomes silence, and the next sample keeps its time.
   * @returns number of the frame that the next `feed` begins with.
   */
  clear(frame?: number): number {
    this.checkOpen();
    const { size, description } = this.sampler;
    const first = frame ?? this.numReturned;
    const oldest = this.numReturned - (this.recent.length - this.join.first);
    if (!(Number.isInteger(first) && first >= oldest && first <= this.numReturned)) {
      throw new Error(`frame ${first} is not remembered; clear one of ${oldest} to ${this.numReturned}`);
    }
    const course = [...this.recent.map(({ pose }) => pose), ...this.held.map(({ pose }) => pose), ...this.expected];
    const start = this.recent.length - (this.numReturned - first); // of frame `first` in it
    const from = (place: number, count: number) => {
      return Array.from({ length: count }, (_, k) => course[Math.min(place + k, course.length - 1)]);
    };
    this.past = joined(from(start - this.join.first, this.past.length / size));
    this.dropped = from(start, Math.ceil(EASE_SECONDS * description.fps) - 1);
    this.firstDropped = first;
    const { state } = this;
    for (; this.numReturned > first; this.numReturned--) this.layers = this.recent.pop()!.layers;
    this.layers.states.state = state;
    this.layers.cues.dropWaiting();
    this.held = [];
    this.expected = [];
    this.numMade = first;
    this.weightRamp = undefined;
    this.join.restart();
    if (frame !== undefined) {
      this.numSamples = Math.min(Math.floor((first * SAMPLE_RATE) / description.fps), this.numSamples);
      this.phrases = undefined;
    }
    this.mel.restart(this.numSamples);
    return first;
  }

  /**
   * Takes the next samples, and returns the frames that became final.
   *
   * @param samples - mono samples at 16 kHz, any number of them. Those that are not finite are taken as silence, those
   *   beyond -1 and 1 are clipped.
   * @param other - as many samples of the person who is spoken with; silence by default.
   * @returns (n, bones, 3) unit vectors, the frames after those that were returned before; n may be 0.
   */
  async feed(samples: Float32Array, other?: Float32Array): Promise<Float32Array> {
    this.checkOpen();
    if (other && other.length !== samples.length) {
      throw new Error(`${other.length} samples of the other; expected ${samples.length}, as many as of the agent`);
    }
    const { num_frames, fps } = this.sampler.description;
    if (other) this.phrases ??= new Phrases((2 * num_frames) / fps + 2, this.numSamples);
    const heard = [samples, other ?? new Float32Array(samples.length)].map(clipped) as [Float32Array, Float32Array];
    const frames = [...this.held];
    let start = 0;
    for (let end = this.needed(); end <= samples.length; end = start + this.needed()) {
      this.hear(heard, start, end);
      frames.push(...(await this.run()).slice(0, this.hop));
      start = end;
    }
    this.hear(heard, start, samples.length);
    // A motion of the speech so far has this many frames; later ones wait, as the speech may end here.
    return this.finished(frames, round((this.numSamples / SAMPLE_RATE) * fps));
  }

  /**
   * Ends the stream, and returns the rest of the frames; after the end of the speech there is silence.
   *
   * @returns (n, bones, 3) unit vectors. All frames of the stream are round(duration x fps), at least 1.
   */
  async flush(): Promise<Float32Array> {
    this.checkOpen();
    this.isEnded = true;
    const count = Math.max(1, round((this.numSamples / SAMPLE_RATE) * this.sampler.description.fps));
    const frames = [...this.held];
    let missing = count - this.numMade;
    while (missing > 0) {
      const shown = await this.run();
      const final = missing <= shown.length ? missing : this.hop; // the rest may be in this window
      frames.push(...shown.slice(0, final));
      missing -= final;
    }
    return this.finished(frames, count);
  }

  /** Generates the next window, and returns the frames from its first new one on. */
  private async run(): Promise<Frame[]> {
    const { description, size } = this.sampler;
    const { num_frames, fps, audio } = description;
    const { first } = this.join;
    const style = Float32Array.from(this.styleRamp.step(this.style, this.hop));
    const pose = unit((await this.restRamp).step(await this.rest, this.hop), 3);
    const start = this.numMade - first;
    const rest = this.idle.frames(pose, start, num_frames, fps);
    const weights = this.weights();
    let window: Float32Array;
    if (weights.some(Boolean)) {
      const mel = this.mel.window(windowColumn(start, fps), audio.columns);
      if (!this.isEnded) hideUnheard(mel, start, this.heard() - start, fps);
      window = await this.sampler.run(mel, style, this.seedPose(pose), this.seed, start);
    } else {
      window = Float32Array.from(rest);
    }
    const rested = withRest(window, rest, weights);
    if (first) {
      const latest = rested.subarray(first * size, (first + this.hop) * size);
      this.past = joined([this.past, latest]).slice(-first * size);
    } else {
      this.past = rested.slice(this.hop * size);
    }
    const shown = withRest(this.join.add(window), rest.subarray(first * size), weights.subarray(first));
    const poses = this.eased(rowsOf(shown, size));
    const number = this.numMade;
    this.expected = poses.slice(this.hop);
    this.numMade += this.hop;
    return poses.map((pose, k) => ({ pose, weight: weights[first + k], ...this.owed(number + k) }));
  }

  /** Returns the poses from which the next window goes on; near rest as they were made. */
  private seedPose(rest: Numbers): Float32Array {
    const { size, description } = this.sampler;
    const made = this.past.slice(0, description.num_seed_frames * size);
    if (!description.noise_dim || this.hop === 1) return made;
    const poses = Float64Array.from(made);
    const mean = Float64Array.from(description.skeleton.mean_directions.flat());
    const distances = norms(poses.map((x, i) => x - rest[i % size]), size);
    const [farthest] = norms(mean.map((x, i) => x - rest[i]), size);
    const shares = distances.map((distance) => MEAN_SHARE * Math.min(distance / farthest, 1) ** 3);
    const mixed = Float64Array.from(poses, (x, i) => x + shares[Math.floor(i / size)] * (mean[i % size] - x));
    return Float32Array.from(unit(mixed, 3));
  }

  /** Returns the next poses as they follow on those that were dropped. */
  private eased(poses: Float32Array[]): Float32Array[] {
    const since = this.numMade - this.firstDropped;
    return poses.map((pose, k) => {
      const dropped = this.dropped[since + k];
      const weight = minimumJerk((since + 1 + k) / (this.dropped.length + 1));
      return dropped ? Float32Array.from(slerp(dropped, pose, weight)) : pose;
    });
  }

  /** Returns what a frame owes to the other. */
  private owed(frame: number): { isAddressed: boolean; nod: number } {
    const { fps } = this.sampler.description;
    const { phrases } = this;
    if (!phrases) return { isAddressed: false, nod: 0 };
    const isAddressed = phrases.hasVoice(frame / fps - ATTENTION, frame / fps + EASE_SECONDS);
    return { isAddressed, nod: nodDepth(phrases.ends, frame, fps) };
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
      const frame = Math.min(this.numMade + k, last);
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
    return this.numMade + this.hop - 1 + this.lookAhead;
  }

  /** Returns the number of samples that the next run still needs. */
  private needed(): number {
    const needed = Math.floor((this.heard() * SAMPLE_RATE) / this.sampler.description.fps);
    return Math.max(needed - this.numSamples, 0);
  }

  private hear([samples, other]: [Float32Array, Float32Array], start: number, end: number): void {
    this.mel.add(samples.subarray(start, end));
    this.phrases?.add(other.subarray(start, end));
    this.numSamples += end - start;
  }

  /** Returns the frames before frame `count` of the motion, with controls, states and cues, and holds the others. */
  private finished(frames: Frame[], count: number): Float32Array {
    const final = frames.slice(0, Math.max(count - this.numReturned, 0));
    this.held = frames.slice(final.length);
    const most = this.join.first + REMEMBERED_SECONDS * this.sampler.description.fps;
    return joined(final.map(({ pose, weight, nod, isAddressed }) => {
      const { controls, states, cues } = this.layers;
      this.recent.push({ pose, layers: { controls: controls.copy(), states: states.copy(), cues: cues.copy() } });
      if (this.recent.length > most) this.recent.shift();
      const controlled = controls.apply(pose, this.energy, this.muted);
      return cues.apply(states.apply(controlled, this.numReturned++, weight, nod, isAddressed, controls.arm));
    }));
  }

  private checkOpen(): void {
    if (this.isEnded) throw new Error("the stream has ended; begin another one with Gesturer.stream");
  }
}

/** Returns samples within -1 and 1, with 0 for those that are not finite. */
function clipped(samples: Float32Array): Float32Array {
  return samples.map((sample) => (Number.isFinite(sample) ? Math.min(Math.max(sample, -1), 1) : 0));
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

/** Checks the options of a stream but style, energy and muted. */
function check(window: number, overlap: number, lookAhead: number, hop: number, reference: number | undefined): void {
  if (!(Number.isInteger(lookAhead) && lookAhead >= 0 && lookAhead <= window)) {
    throw new Error(`the look-ahead is ${lookAhead}; expected 0 to ${window} frames, the window of the model`);
  }
  const longest = window - 2 * overlap;
  if (!(Number.isInteger(hop) && hop >= 1 && hop <= longest)) {
    throw new Error(`the hop is ${hop}; expected 1 to ${longest} frames`);
  }
  if (reference !== undefined && !(typeof reference === "number" && reference >= 0 && reference < Infinity)) {
    throw new Error(`the mel power of 0 dB is ${reference}; expected a number from 0 on`);
  }
}
