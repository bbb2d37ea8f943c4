/** Gestures that are asked for, blended into a motion that goes on, as in `ha2g_jax/motion/cues/running.py`. */

import type { Description, Keyframes } from "../description.js";
import { round } from "../rounding.js";
import { applyRotations, power, type Rotations, rotationsFrom } from "./control/local-rotations.js";
import { copyOf } from "./control/running.js";
import { type Part, parts } from "./control/parts.js";
import { minimumJerk } from "./minimum-jerk.js";
import { fromVector, rotate } from "./rotations.js";
import { angleBetween, slerp } from "./sphere.js";

const MAX_SPEED = 9; // radians per second: the greatest angular speed of a bone that a cue moves
const PEAK_SPEED = 1.875; // of a minimum-jerk movement, relative to its mean speed

/** A gesture that waits or runs. */
interface Running {
  keys: Keyframes;
  /** Number of the frame of its peak; undefined is as soon as possible. */
  peak: number | undefined;
  /** Limbs that no later gesture has taken over. */
  limbs: string[];
  /** Seconds from its beginning to its first keyframe; undefined while it waits. */
  ramp?: number;
  /** Frame by which it is later than other gestures: its peak, or that of one as soon as possible that began later. */
  rank: number;
  isPlanned: boolean;
  /** Last rotations from its pose to the motion, by limb, from which the next ones continue. */
  rotations: Map<string, Rotations>;
}

/** Gestures that are blended into a motion, each with its peak in a given frame. */
export class RunningCues {
  private frame = 0; // number of the next frame of the motion
  private last: Float32Array | undefined;
  private readonly limbs: Record<string, number[]>; // bones of each limb
  private readonly parts: Record<string, Part[]>;
  private cues: Running[] = []; // those that run, in the order in which they began, and then those that wait

  /** @param description - model with the limbs and the cues of its skeleton. */
  constructor(private readonly description: Description) {
    this.limbs = description.limbs;
    this.parts = Object.fromEntries(Object.entries(this.limbs).map(([limb, bones]) => {
      return [limb, parts(description.skeleton).filter((part) => part.bones.every((bone) => bones.includes(bone)))];
    }));
  }

  /** Returns cues that go on from here on their own. */
  copy(): RunningCues {
    const copy = copyOf(this);
    copy.cues = this.cues.map((cue) => ({ ...cue, rotations: new Map(cue.rotations) }));
    return copy;
  }

  /** Drops the gestures that have not begun. */
  dropWaiting(): void {
    this.cues = this.cues.filter((cue) => cue.ramp !== undefined);
  }

  /** Adds a gesture of the model whose peak is at a time of the motion in seconds, by default as soon as possible. */
  add(name: string, time?: number): void {
    const keys = checkCue(this.description, name, time);
    const peak = time === undefined ? undefined : round(time * this.description.fps);
    const limbs = [...Object.keys(keys.poses), ...Object.keys(keys.turns)];
    this.cues.push({ keys, peak, limbs, rank: 0, isPlanned: false, rotations: new Map() });
  }

  /** Returns the next frame (bones, 3) with gestures; without any, the same array. */
  apply(motion: Float32Array): Float32Array {
    const frame = this.cues.length ? this.next(motion) : motion;
    this.last = frame;
    this.frame++;
    return frame;
  }

  private next(motion: Float32Array): Float32Array {
    this.begin(motion);
    const running = this.cues.filter((cue) => cue.ramp !== undefined).sort((one, other) => one.rank - other.rank);
    const frame = motion.slice();
    running.forEach((cue, index) => {
      if (this.time(cue) < 0) return;
      for (const earlier of running.slice(0, index)) {
        earlier.limbs = earlier.limbs.filter((limb) => !cue.limbs.includes(limb));
      }
    });
    running.forEach((cue, index) => this.blend(frame, cue, running.slice(index + 1)));
    const late = this.slowDown(frame, new Set(running.flatMap((cue) => cue.limbs)));
    this.cues = this.cues.filter((cue) => {
      if (cue.ramp === undefined) return true;
      const goesOn = this.time(cue) < cue.keys.weight_times.at(-1)! || cue.limbs.some((limb) => late.has(limb));
      return cue.limbs.length && goesOn;
    });
    return frame;
  }

  /** Begins the gestures whose time has come. */
  private begin(motion: Float32Array): void {
    const { fps } = this.description;
    const present = this.last ?? motion;
    const running = this.cues.filter((cue) => cue.ramp !== undefined).sort((one, other) => one.rank - other.rank);
    const waiting = this.cues.filter((cue) => cue.ramp === undefined);
    for (const cue of waiting) {
      const [start, first] = cue.keys.weight_times;
      const ramp = Math.max(first - start, (this.way(cue, present) * PEAK_SPEED) / MAX_SPEED);
      const soonest = this.frame - 1 + Math.ceil((ramp - first) * fps);
      const isSoon = cue.peak === undefined;
      cue.peak ??= soonest;
      if (this.last && !cue.isPlanned) cue.peak = Math.max(cue.peak, soonest);
      if (!cue.isPlanned) cue.rank = cue.peak;
      if (isSoon) for (const one of running) one.rank = Math.min(one.rank, cue.rank);
      cue.isPlanned = true;
      if (cue.peak > soonest) continue;
      cue.ramp = this.last ? Math.max((cue.peak - this.frame + 1) / fps + first, 1 / fps) : ramp;
      running.push(cue);
    }
    this.cues = [...running, ...waiting.filter((cue) => cue.ramp === undefined)];
  }

  /** Returns the angle that a bone turns at most from the present pose to the first one of a gesture. */
  private way(cue: Running, present: Float32Array): number {
    const angles = Object.entries(cue.keys.poses).flatMap(([limb, poses]) => {
      return this.limbs[limb].map((bone, k) => angleBetween(present.subarray(3 * bone, 3 * bone + 3), poses[0][k]));
    });
    return Math.max(0, ...angles);
  }

  /** Blends a gesture into a frame (bones, 3), in place, under those that began later. */
  private blend(frame: Float32Array, cue: Running, later: Running[]): void {
    const { keys } = cue;
    const weight = this.weight(cue);
    if (!weight) return;
    const [before, after, fraction] = place(keys.times, this.time(cue));
    for (const limb of cue.limbs) {
      const poses = keys.poses[limb];
      if (poses) {
        const pose = slerp(flat(poses[before]), flat(poses[after]), fraction);
        this.blendPose(frame, pose, weight, cue, limb);
        continue;
      }
      const others = later.filter((other) => other.keys.turns[limb]);
      const share = others.reduce((product, other) => product * (1 - this.weight(other)), weight);
      const [from, to] = [before, after].map((key) => keys.turns[limb][key]);
      const turn = fromVector(Float64Array.from(from, (value, k) => share * (value + fraction * (to[k] - value))));
      for (const bone of this.limbs[limb]) {
        frame.set(rotate(turn, Float64Array.from(frame.subarray(3 * bone, 3 * bone + 3))), 3 * bone);
      }
    }
  }

  /** Moves a limb of a frame (bones, 3) toward a pose of the limb. */
  private blendPose(frame: Float32Array, pose: Float64Array, weight: number, cue: Running, limb: string): void {
    const chosen = this.parts[limb];
    const reference = Float64Array.from(frame);
    this.limbs[limb].forEach((bone, k) => reference.set(pose.subarray(3 * k, 3 * k + 3), 3 * bone));
    const rotations = rotationsFrom(reference, frame, chosen);
    const before = cue.rotations.get(limb);
    for (const [key, rotation] of before ? rotations : []) {
      const product = rotation.reduce((sum, value, k) => sum + value * before!.get(key)![k], 0);
      if (product < 0) rotations.set(key, rotation.map((value) => -value));
    }
    cue.rotations.set(limb, rotations);
    const left = Float64Array.of(1 - weight);
    const scaled = new Map([...rotations].map(([key, rotation]) => [key, power(rotation, left)]));
    applyRotations(reference, scaled, chosen, frame);
  }

  /** Turns the bones of limbs no farther than `MAX_SPEED` allows, in place, and returns the limbs that are late. */
  private slowDown(frame: Float32Array, moved: Set<string>): Set<string> {
    const late = new Set<string>();
    const most = MAX_SPEED / this.description.fps;
    for (const limb of this.last ? moved : []) {
      for (const bone of this.limbs[limb]) {
        const [from, to] = [this.last!, frame].map((pose) => pose.subarray(3 * bone, 3 * bone + 3));
        const turned = angleBetween(from, to);
        if (turned <= most) continue;
        frame.set(slerp(from, to, most / turned), 3 * bone);
        late.add(limb);
      }
    }
    return late;
  }

  private time(cue: Running): number {
    return (this.frame - (cue.peak ?? 0)) / this.description.fps;
  }

  private weight(cue: Running): number {
    const [, first, ...others] = cue.keys.weight_times;
    const [before, after, fraction] = place([first - (cue.ramp ?? 0), first, ...others], this.time(cue));
    const { weights } = cue.keys;
    return weights[before] + fraction * (weights[after] - weights[before]);
  }
}

/**
 * Checks a cue, and returns its keyframes.
 *
 * @throws Error if the model has no such cue, or the time is below 0 or no time.
 */
export function checkCue({ cues }: Description, name: string, time?: number): Keyframes {
  if (!Object.hasOwn(cues, name)) throw new Error(`no cue "${name}"; expected one of: ${Object.keys(cues).join(", ")}`);
  if (time !== undefined && !(time >= 0 && time < Infinity)) {
    throw new Error(`the time of a cue is ${time}; expected seconds, at least 0`);
  }
  return cues[name];
}

/** Returns the keyframes before and after a time, and the share of the way between them, by minimum jerk. */
function place(times: number[], time: number): [before: number, after: number, fraction: number] {
  const later = times.findIndex((moment) => moment > time);
  const after = Math.min(Math.max(later < 0 ? times.length : later, 1), times.length - 1);
  const before = Math.max(after - 1, 0);
  const span = times[after] - times[before];
  const share = span ? Math.min(Math.max((time - times[before]) / span, 0), 1) : 0;
  return [before, after, minimumJerk(share)];
}

const flat = (pose: number[][]) => Float64Array.from(pose.flat());
