/** What a body does while it does not speak, as in `ha2g_jax/motion/states.py`: it idles, listens or thinks. */

import type { Skeleton } from "../description.js";
import { normal } from "../sound/noise.js";
import { copyOf } from "./control/running.js";
import { armParts, parts, restPose, SIDES } from "./control/parts.js";
import type { Idle } from "./idle.js";
import { round } from "../rounding.js";
import { minimumJerk } from "./minimum-jerk.js";
import { between, fromVector, type Numbers, radians, rotate, unit } from "./rotations.js";
import { slerp } from "./sphere.js";

/** What the body does where the agent does not speak; "auto" listens while the other speaks and idles otherwise. */
export type State = "auto" | "idle" | "listen" | "think";

export const STATES: readonly State[] = ["auto", "idle", "listen", "think"];
export const ATTENTION = 1.5; // seconds for which someone listens on after the other's last voice
const EASE_SECONDS = 0.4; // of a transition
const NOD_DELAY = 0.7; // seconds from the end of a phrase to the lowest point of the nod
const [NOD_DEGREES, NOD_SECONDS] = [13, 0.27]; // depth; seconds from its start to its lowest point, and from there on

// Amounts of idle shifts, of a lean ahead, of turning the head to the other and of nods; of the degrees by which the
// head turns to the left and down; and of raising each arm.
const POSTURES = {
  speak: [0, 0, 0, 0, 0, 0, 0, 0],
  idle: [1, 0, 0, 0, 0, 0, 0, 0],
  listen: [0.3, 1, 1, 1, 0, 0, 0, 0],
};
const FIRST_CHANNEL = 2048; // of the noise that thoughts are drawn from
const LEAN_DEGREES = 5;
const GAZE_DEGREES = [[22, 38], [-12, 8]]; // of who thinks: to a side, and down
// Directions of the upper arm and of the forearm of a hand below the chin, to the side of the arm, down and ahead.
const RAISED = [[0.2, 0.96, 0.15], [-0.7, -0.4, 0.6]];

/** The movement that states add to the frames of a motion that goes on. */
export class RunningStates {
  private ramp: Ease | undefined; // begins at the first frame
  private weight = 0; // of the speech, in the frame before
  private thought: number[] = [];
  private current: State = "auto";
  private numThoughts = 0;
  private readonly frames: number;
  private readonly leftward: number; // x of the figure's left
  private readonly trunk: number[];
  private readonly head: number[];
  private readonly arms: number[][]; // bones, upper arm and forearm first
  private readonly raised: Numbers[]; // (2, 3) upper arm and forearm of each arm with the hand below the chin
  private readonly rest: Numbers;

  /**
   * @param skeleton - skeleton of the motion.
   * @param idle - shifts of the figure.
   * @param fps - frames per second.
   * @param seed - seed of the thoughts.
   */
  constructor(
    skeleton: Skeleton,
    private readonly idle: Idle,
    private readonly fps: number,
    private readonly seed: number,
  ) {
    const shoulder = skeleton.bones.findIndex(([, child]) => skeleton.joints[child] === "left_shoulder");
    const bonesOf = (kind: string) => parts(skeleton).filter((part) => part.kind === kind).flatMap((part) => part.bones);
    this.frames = Math.ceil(EASE_SECONDS * fps);
    this.leftward = Math.sign(skeleton.mean_directions[shoulder][0]);
    [this.trunk, this.head] = [bonesOf("trunk"), bonesOf("head")];
    this.arms = SIDES.map((side) => armParts(skeleton, side).flatMap((part) => part.bones));
    this.raised = [this.leftward, -this.leftward].map((outward) => {
      return unit(Float64Array.from(RAISED.flat()), 3).map((value, k) => value * [outward, 1, -this.leftward][k % 3]);
    });
    this.rest = restPose(skeleton);
  }

  /** Returns states that go on from here on their own. */
  copy(): RunningStates {
    const copy = copyOf(this);
    copy.ramp = this.ramp && copyOf(this.ramp);
    return copy;
  }

  get state(): State {
    return this.current;
  }

  set state(state: State) {
    checkState(state);
    if (state === "think" && this.current !== "think") this.thought = this.think();
    this.current = state;
  }

  /**
   * Adds the movement to the next frame.
   *
   * @param frame - (bones, 3) unit vectors.
   * @param number - number of the frame.
   * @param weight - weight of the motion of speech in the frame; where it is 1 the frame stays as it is.
   * @param nod - depth of a nod in the frame, 0 to 1.
   * @param isAddressed - whether the other speaks.
   * @param arm - weight of the movement of the arms, 0 where they rest.
   */
  apply(
    frame: Float32Array,
    number: number,
    weight: number,
    nod: number,
    isAddressed: boolean,
    arm: number,
  ): Float32Array {
    const begins = weight > this.weight;
    if (begins && this.current === "think") this.current = "auto";
    const state = this.current === "auto" ? (isAddressed ? "listen" : "idle") : this.current;
    const posture = state === "think" ? this.thought : POSTURES[state];
    const target = begins || weight === 1 ? POSTURES.speak : posture;
    this.ramp ??= new Ease(target, this.frames);
    this.weight = weight;
    const amounts = this.ramp.step(target);
    return amounts.some(Boolean) ? this.moved(frame, number, amounts, nod, arm) : frame;
  }

  private moved(frame: Float32Array, number: number, amounts: number[], nod: number, arm: number): Float32Array {
    const [shift, lean, ahead, nods, aside, down, ...raised] = amounts;
    const moved = Float64Array.from(frame);
    const turns = this.idle.shifts(number, this.fps).map((value) => shift * value);
    this.arms.forEach(([upper, fore, ...hand], side) => {
      for (const bone of [upper, fore, ...hand]) for (let k = 3 * bone; k < 3 * bone + 3; k++) turns[k] *= arm;
      const share = raised[side] * arm;
      if (!share) return;
      const [above, below] = [upper, fore].map((bone) => moved.slice(3 * bone, 3 * bone + 3));
      const bent = slerp(Float64Array.of(...above, ...below), this.raised[side], share);
      const turn = between(below, bent.slice(3));
      for (const bone of hand) moved.set(rotate(turn, moved.slice(3 * bone, 3 * bone + 3)), 3 * bone);
      moved.set(bent.subarray(0, 3), 3 * upper);
      moved.set(bent.subarray(3), 3 * fore);
    });
    for (const bone of this.trunk) turns[3 * bone] += this.leftward * radians(lean * LEAN_DEGREES);
    const yaw = ahead && ahead * this.yaw(frame);
    for (const bone of this.head) {
      turns[3 * bone] += this.leftward * radians(down + nods * nod * NOD_DEGREES);
      turns[3 * bone + 1] -= radians(aside) - yaw; // up is at -y
    }
    return Float32Array.from(rotate(fromVector(turns), moved));
  }

  /** Returns the angle in radians by which the head of a pose is turned to the left. */
  private yaw(pose: Float32Array): number {
    let [sine, cosine] = [0, 0];
    for (const bone of this.head) {
      const [x, z, u, w] = [this.rest[3 * bone], this.rest[3 * bone + 2], pose[3 * bone], pose[3 * bone + 2]];
      sine += x * w - z * u;
      cosine += x * u + z * w;
    }
    return Math.atan2(sine, cosine);
  }

  /** Returns the amounts of the next thought, whose gaze and arm are drawn. */
  private think(): number[] {
    const draws = [0, 1, 2, 3].map((channel) => {
      const drawn = 16 * normal(this.seed, this.numThoughts, FIRST_CHANNEL + channel);
      return drawn - Math.floor(drawn);
    });
    this.numThoughts++;
    const [aside, down] = GAZE_DEGREES.map(([low, high], k) => low + draws[k + 1] * (high - low));
    return [0.3, 0, 0, 0, draws[0] < 0.5 ? aside : -aside, down, ...(draws[3] < 0.5 ? [1, 0] : [0, 1])];
  }
}

/**
 * Returns the depth of the nod at a frame, 0 to 1: a nod is lowest 0.7 s after the end of a phrase of the other's voice.
 *
 * @param ends - ends of phrases in seconds.
 */
export function nodDepth(ends: number[], frame: number, fps: number): number {
  const depths = ends.map((end) => {
    const away = Math.abs(frame - round((end + NOD_DELAY) * fps)) / (NOD_SECONDS * fps);
    return minimumJerk(1 - Math.min(away, 1));
  });
  return Math.max(0, ...depths);
}

/** Checks a state. */
export function checkState(state: State): void {
  if (!STATES.includes(state)) throw new Error(`the state is "${state}"; expected one of: ${STATES.join(", ")}`);
}

/**
 * Values that reach new ones a number of frames later, along a curve of the fifth degree, which goes on with the present
 * velocity and acceleration and ends at rest.
 */
class Ease {
  private target: number[];
  private frame: number;
  private curve: number[][] = []; // coefficients of the way that is left, of the time from 0 to 1

  constructor(
    values: number[],
    private readonly frames: number,
  ) {
    this.target = values;
    this.frame = frames;
  }

  /** Returns the values of the next frame, on the way to a target. */
  step(target: number[]): number[] {
    if (target.some((value, k) => value !== this.target[k])) {
      const time = this.frame / this.frames;
      const start = [0, 1, 2].map((derivative) => this.at(time, derivative));
      start[0] = start[0].map((value, k) => value + this.target[k] - target[k]);
      start[2] = start[2].map((value) => value / 2);
      const ending = ENDING.map((row) => target.map((_, k) => row.reduce((sum, part, n) => sum + part * start[n][k], 0)));
      this.curve = [...start, ...ending];
      this.target = target;
      this.frame = 0;
    }
    this.frame = Math.min(this.frame + 1, this.frames);
    if (this.frame === this.frames) this.curve = [];
    return this.at(this.frame / this.frames, 0).map((value, k) => value + this.target[k]);
  }

  /** Returns the way that is left at a time, or a derivative of it. */
  private at(time: number, derivative: number): number[] {
    const powers = this.curve.map((_, power) => {
      let factor = 1;
      for (let k = 0; k < derivative; k++) factor *= power - k;
      return factor * time ** Math.max(power - derivative, 0);
    });
    return this.target.map((_, k) => this.curve.reduce((sum, row, power) => sum + powers[power] * row[k], 0));
  }
}

// Coefficients 3 to 5 of the curve that is 0 and at rest at the time 1, from those before them.
const ENDING = [[-10, -6, -3], [15, 8, 3], [-6, -3, -1]];
