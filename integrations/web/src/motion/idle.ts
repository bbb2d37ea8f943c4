/** Idle movement of a figure that rests: it breathes and sways a little, as in `ha2g_jax/motion/idle.py`. */

import type { Skeleton } from "../description.js";
import { normal, noiseTrack } from "../sound/noise.js";
import { armParts, parts, SIDES } from "./control/parts.js";
import { minimumJerk } from "./minimum-jerk.js";
import { cross, fromVector, type Numbers, radians, rotate, unit } from "./rotations.js";

const SLOWNESS = 1.5; // of the noise, which so changes within three seconds
const BREATHS = 0.25; // per second
const BREATH_DEGREES = 0.7; // by which the shoulders rise and fall
const [BREATH_PHASE, BREATH_DEPTH] = [0.7, 0.25]; // standard deviations of the phase in radians, and of the depth

// Standard deviations in degrees about the axes x (lean), y (turn) and z (tilt), of the body, of the head on it, and of
// each arm.
const [BODY, HEAD, ARM] = [[0.5, 1.2, 0.5], [0.8, 1.5, 0.5], [0.7, 0.4, 0.4]];

// Of shifts: seconds between two of them and of each, and degrees about the axes, of the trunk, of the head, and of each
// arm and of its forearm on it.
const TRUNK_SHIFT = { span: 9, seconds: 2, degrees: [0, 1.5, 1.5] };
const GAZE_SHIFT = { span: 3.5, seconds: 0.5, degrees: [4, 10, 2] };
const ARM_SHIFT = { span: 6, seconds: 2.5, degrees: [2.4, 0, 2], forearm: [4, 5, 0] };
const FARTHEST = 1.6; // standard deviations of a shift
const [FIRST_CHANNEL, MOST_CHANNELS] = [1024, 16]; // of the noise, for each kind of shift

/** Moves of some bones, which take some seconds, one in each span of time. */
interface Shift {
  span: number;
  seconds: number;
  turns: Numbers[]; // (bones, 3) rotation vectors
}

/** A figure that breathes and sways, and now and then shifts and looks elsewhere. */
export class Idle {
  private readonly turns: Numbers[]; // (bones, 3) rotation vectors of a breath, and of each of the other movements
  private readonly kinds: Shift[];

  constructor(
    private readonly skeleton: Skeleton,
    private readonly seed: number,
  ) {
    const all = [...skeleton.bones.keys()];
    const head = parts(skeleton).filter((part) => part.kind === "head").flatMap((part) => part.bones);
    const arms = SIDES.map((side) => armParts(skeleton, side).flatMap((part) => part.bones));
    const moved: [number[], number[]][] = [[all, BODY], [head, HEAD], ...arms.map((arm): [number[], number[]] => [arm, ARM])];
    this.turns = [this.breath(), ...moved.flatMap(([bones, degrees]) => this.aboutAxes(bones, degrees))];
    const trunk = parts(skeleton).filter((part) => part.kind === "trunk").flatMap((part) => part.bones);
    this.kinds = [
      { ...TRUNK_SHIFT, turns: this.aboutAxes(trunk, TRUNK_SHIFT.degrees) },
      { ...GAZE_SHIFT, turns: this.aboutAxes(head, GAZE_SHIFT.degrees) },
      ...arms.map((arm) => {
        const turns = [...this.aboutAxes(arm, ARM_SHIFT.degrees), ...this.aboutAxes(arm.slice(1), ARM_SHIFT.forearm)];
        return { ...ARM_SHIFT, turns };
      }),
    ];
  }

  /**
   * Returns a pose as it breathes and sways.
   *
   * @param pose - (bones, 3) unit vectors.
   * @param first - number of the first frame, which may be negative.
   * @param count - number of frames.
   * @param fps - frames per second.
   * @returns (count, bones, 3) unit vectors.
   */
  frames(pose: Numbers, first: number, count: number, fps: number): Numbers {
    const dim = 2 * (1 + this.turns.length);
    const noise = noiseTrack(this.seed, first, count, SLOWNESS * fps, dim);
    const result = new Float64Array(count * pose.length);
    for (let k = 0; k < count; k++) {
      const [shift, depth, ...sway] = noise.subarray(k * dim, k * dim + dim / 2);
      const phase = ((2 * Math.PI * BREATHS) / fps) * (first + k) + BREATH_PHASE * shift;
      const amounts = [(1 + BREATH_DEPTH * depth) * Math.sin(phase), ...sway];
      const vectors = pose.map((_, at) => amounts.reduce((sum, amount, index) => sum + amount * this.turns[index][at], 0));
      result.set(rotate(fromVector(vectors), pose), k * pose.length);
    }
    return result;
  }

  /** Returns the rotation vectors (bones, 3) in radians by which the figure has shifted at a frame. */
  shifts(frame: number, fps: number): Numbers {
    const total = new Float64Array(3 * this.skeleton.bones.length);
    this.kinds.forEach(({ span, seconds, turns }, kind) => {
      const place = frame / (span * fps);
      const before = Math.floor(place);
      const draw = (point: number, turn: number) => {
        return normal(this.seed, point, FIRST_CHANNEL + MOST_CHANNELS * kind + turn);
      };
      const moment = 16 * draw(before, turns.length); // the last channel has the moment of the move
      const start = (1 - seconds / span) * (moment - Math.floor(moment));
      const weight = minimumJerk(Math.min(Math.max(((place - before - start) * span) / seconds, 0), 1));
      turns.forEach((turn, k) => {
        const [from, to] = [before - 1, before].map((point) => {
          return Math.min(Math.max(draw(point, k), -FARTHEST), FARTHEST);
        });
        const amount = from + weight * (to - from);
        for (let at = 0; at < total.length; at++) total[at] += amount * turn[at];
      });
    });
    return total;
  }

  /** Returns the rotation vectors (bones, 3) of bones by degrees about each axis. */
  private aboutAxes(bones: number[], degrees: number[]): Numbers[] {
    return degrees.map((angle, axis) => {
      const turn = new Float64Array(3 * this.skeleton.bones.length);
      for (const bone of bones) turn[3 * bone + axis] = radians(angle);
      return turn;
    });
  }

  /** Returns the rotation vectors (bones, 3) that raise the shoulders. */
  private breath(): Numbers {
    const { bones, joints, mean_directions } = this.skeleton;
    const turn = new Float64Array(3 * bones.length);
    for (const side of SIDES) {
      const bone = bones.findIndex(([, child]) => child === joints.indexOf(`${side}_shoulder`));
      const axis = unit(cross(Float64Array.from(mean_directions[bone]), Float64Array.of(0, -1, 0)), 3);
      turn.set(axis.map((value) => radians(BREATH_DEGREES) * value), 3 * bone);
    }
    return turn;
  }
}
