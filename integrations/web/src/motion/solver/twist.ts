/**
 * Estimation of the twist of a bone, its rotation about its own length, from weighted observations over time.
 *
 * An observation is a complex number whose angle is the twist and whose absolute value is the weight; (T) observations
 * are a flat array T x 2.
 */

import { about, between, conjugate, cross, dot, IDENTITY, multiply, rotate, unit, wrapped } from "../rotations.js";
import type { Numbers } from "../rotations.js";

/**
 * Seconds squared. An observation of weight w is averaged over sqrt(STIFFNESS / w) seconds: 6 ms for weight 1, more
 * than a second for 2e-5.
 */
const STIFFNESS = 4e-5;
/** Weight of a frame without an observation. */
const NOTHING = 1e-12;

/** Estimates of what depends on other frames, of each bone under the name of the joint that rotates it. */
export interface Twists {
  /** Returns the (T x 4) rotations of the function `transport`. */
  transport(joint: string, above: Numbers, axis: Numbers, along: Numbers): Numbers;
  /** Returns (T) angles in radians for (T x 2) observations. */
  smooth(joint: string, observations: Numbers): Numbers;
}

/** Twists of a motion whose frames are all known. */
export class WholeMotion implements Twists {
  constructor(private readonly fps: number) {}

  transport(_: string, above: Numbers, axis: Numbers, along: Numbers): Numbers {
    return transport(above, axis, along);
  }

  smooth(_: string, observations: Numbers): Numbers {
    return smoothAngle(observations, this.fps);
  }
}

/** Twists of frames that arrive in order, in any number at a time; a frame does not depend on later ones. */
export class FrameByFrame implements Twists {
  private readonly ends = new Map<string, [Numbers, Numbers]>();
  private readonly known = new Map<string, Known>();

  constructor(private readonly fps: number) {}

  transport(joint: string, above: Numbers, axis: Numbers, along: Numbers): Numbers {
    const frames = transport(above, axis, along, this.ends.get(joint));
    this.ends.set(joint, [above.slice(-4), frames.slice(-4)]);
    return frames;
  }

  smooth(joint: string, observations: Numbers): Numbers {
    const angles = new Float64Array(observations.length / 2);
    for (let k = 0; k < angles.length; k++) {
      const known = continueAngle(observations[2 * k], observations[2 * k + 1], this.fps, this.known.get(joint));
      this.known.set(joint, known);
      angles[k] = known.angle;
    }
    return angles;
  }
}

/**
 * Transports a bone along its path without twist relative to its parent (parallel transport).
 *
 * @param above - (T x 4) rotations of the parent.
 * @param axis - (3,) unit vector of the bone at rest.
 * @param along - (T x 3) unit vectors of the bone over time.
 * @param before - rotations of the parent and of the bone in the frame before; by default the bone is at rest there.
 * @returns (T x 4) rotations that take `axis` to `along`, each continued from the frame before by the shortest one.
 */
export function transport(above: Numbers, axis: Numbers, along: Numbers, before?: [Numbers, Numbers]): Numbers {
  const path = rotate(conjugate(above), along);
  let last = before ? multiply(conjugate(before[0]), before[1]) : IDENTITY;
  let end = rotate(last, axis);
  const steps = new Float64Array((path.length / 3) * 4);
  for (let k = 0; k < path.length / 3; k++) {
    const next = path.subarray(3 * k, 3 * k + 3);
    last = unit(multiply(between(end, next), last), 4);
    steps.set(last, 4 * k);
    end = next;
  }
  return swing(multiply(above, steps), axis, along);
}

/** Rotates frames (T x 4) further by the shortest rotations that align a bone (3) with directions (T x 3). */
export function swing(frames: Numbers, axis: Numbers, along: Numbers): Numbers {
  return multiply(between(rotate(frames, axis), along), frames);
}

/**
 * Estimates the twist of a bone from the observed direction of a mark on its side.
 *
 * @param frames - (T x 4) rotations of the bone without the twist.
 * @param axis - (3,) unit vector of the bone at rest.
 * @param mark - (3,) unit vector at right angles to the bone at rest.
 * @param seen - (T x 3) observed directions of the mark; only the component at right angles to the bone counts.
 * @param weight - (T) weights or one number; 1 for a twist that is clearly visible.
 * @returns (T x 2) observations.
 */
export function observe(
  frames: Numbers,
  axis: Numbers,
  mark: Numbers,
  seen: Numbers,
  weight: Numbers | number,
): Numbers {
  const local = rotate(conjugate(frames), seen);
  const real = dot(local, mark);
  const imaginary = dot(local, cross(axis, mark));
  const out = new Float64Array(2 * real.length);
  for (let k = 0; k < real.length; k++) {
    const length = Math.max(Math.hypot(real[k], imaginary[k]), 1e-9);
    const own = typeof weight === "number" ? weight : weight[k];
    out[2 * k] = (own * real[k]) / length;
    out[2 * k + 1] = (own * imaginary[k]) / length;
  }
  return out;
}

/** Adds to observations (T x 2) others (T x 2), or one real number to each. */
export function plus(observations: Numbers, others: Numbers | number): Numbers {
  if (typeof others === "number") return observations.map((value, k) => (k % 2 ? value : value + others));
  return observations.map((value, k) => value + others[k]);
}

/** Rotates a bone (T x 4) about its own length, `axis` (3) at rest, by angles (T) in radians. */
export function applyTwist(frames: Numbers, axis: Numbers, angles: Numbers): Numbers {
  return multiply(frames, about(axis, angles));
}

/**
 * Fits angles over time that minimise the integral of w (angle - seen)^2 + stiffness (rate of the angle)^2.
 *
 * @param observations - (T x 2) sums of results of `observe`.
 * @param fps - frames per second.
 * @returns (T) angles in radians, continuous over time.
 */
export function smoothAngle(observations: Numbers, fps: number): Numbers {
  const real = observations.filter((_, k) => k % 2 === 0);
  const imaginary = observations.filter((_, k) => k % 2 === 1);
  const seen = real.map((value, k) => Math.atan2(imaginary[k], value));
  if (seen.length === 1) return seen;
  const weight = real.map((value, k) => Math.max(Math.hypot(value, imaginary[k]), NOTHING));
  const solve = smoother(weight, STIFFNESS * fps * fps);
  // A point of the plane is fitted first: it needs no unwrapping, but lags where the angle changes fast.
  const [x, y] = [solve(real), solve(imaginary)];
  const near = unwrap(x.map((value, k) => Math.atan2(y[k], value)));
  return solve(near.map((angle, k) => weight[k] * (angle + wrapped(seen[k] - angle))));
}

/** Returns angles in radians plus whole turns, so that no step is longer than half a turn. */
export function unwrap(angles: Numbers): Numbers {
  const out = angles.slice();
  for (let k = 1; k < out.length; k++) out[k] = out[k - 1] + wrapped(angles[k] - angles[k - 1]);
  return out;
}

/** Returns the solver of the tridiagonal system of `smoothAngle`, by elimination from the first frame on. */
function smoother(weight: Numbers, stiffness: number): (right: Numbers) => Numbers {
  const last = weight.length - 1;
  const pivot = weight.slice();
  for (let k = 0; k < last; k++) {
    pivot[k + 1] += (pivot[k] * stiffness) / (pivot[k] + stiffness);
    pivot[k] += stiffness;
  }
  return (right) => {
    const out = right.slice();
    for (let k = 1; k <= last; k++) out[k] += (stiffness / pivot[k - 1]) * out[k - 1];
    out[last] /= pivot[last];
    for (let k = last - 1; k >= 0; k--) out[k] = (out[k] + stiffness * out[k + 1]) / pivot[k];
    return out;
  };
}

/** What the observations up to a frame say of an angle. */
interface Known {
  /** Weight of all of them, as of one observation in this frame. */
  weight: number;
  /** Their weighted mean, as a complex number. */
  point: [number, number];
  /** Angle of `point` in radians, continuous over time. */
  near: number;
  /** Angle in this frame, in radians. */
  angle: number;
}

/**
 * Fits the angle of one further frame, the last angle of `smoothAngle` with the observations up to it.
 *
 * This is the elimination of its system, frame by frame: a Kalman filter of a random walk.
 */
function continueAngle(real: number, imaginary: number, fps: number, before?: Known): Known {
  const weight = Math.max(Math.hypot(real, imaginary), NOTHING);
  const direction = Math.atan2(imaginary, real);
  if (!before) return { weight, point: [real / weight, imaginary / weight], near: direction, angle: direction };
  const stiffness = STIFFNESS * fps * fps;
  const held = (before.weight * stiffness) / (before.weight + stiffness);
  const total = held + weight;
  const x = (held * before.point[0] + real) / total;
  const y = (held * before.point[1] + imaginary) / total;
  const near = before.near + wrapped(Math.atan2(y, x) - before.near);
  const seen = near + wrapped(direction - near);
  return { weight: total, point: [x, y], near, angle: (held * before.angle + weight * seen) / total };
}
