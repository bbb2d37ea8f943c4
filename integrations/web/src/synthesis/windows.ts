/**
 * Joining of overlapping windows to one motion, as in `ha2g_jax/motion/windows.py`.
 *
 * Motions and windows are flat arrays (frames, size) with `size` = 3 x bones numbers in a frame.
 */

import { minimumJerk } from "../motion/minimum-jerk.js";
import { between, fromVector, norms, rotate, toVector } from "../motion/rotations.js";
import { expMap, logMap, slerp } from "../motion/sphere.js";

const EASE_FRAMES = 10;
const TOLERANCE = 2; // times the usual distance from the course, which is no step

/**
 * Returns the number of windows that cover a motion.
 *
 * @param frames - frames T of the motion.
 * @param window - frames N of a window.
 * @param overlap - frames M that two consecutive windows have in common.
 */
export function numWindows(frames: number, window: number, overlap: number): number {
  return Math.max(1, Math.ceil((frames - window) / (window - overlap)) + 1);
}

/**
 * Joins windows to one motion, with a crossfade over the frames that two windows have in common.
 *
 * @param windows - K windows (N, size) of unit vectors.
 * @param overlap - frames M that two consecutive windows have in common.
 * @param size - numbers in a frame.
 * @returns (N + (K - 1)(N - M), size) unit vectors.
 */
export function joinWindows(windows: Float32Array[], overlap: number, size: number): Float32Array {
  const length = windows[0].length;
  const stride = length - overlap * size;
  const joined = new Float32Array(length + (windows.length - 1) * stride);
  windows.forEach((window, index) => {
    const start = index * stride;
    const faded = index ? fade(joined.subarray(start, start + overlap * size), window, overlap, size) : window;
    joined.set(faded, start);
  });
  return joined;
}

/**
 * Removes the step in a motion of `joinWindows` at the border after the frames that two windows have in common.
 *
 * @param motion - (T, size) unit vectors.
 * @param window - frames N of a window.
 * @param overlap - frames M that two consecutive windows have in common.
 * @param size - numbers in a frame.
 * @returns (T, size) unit vectors.
 */
export function easeBorders(motion: Float32Array, window: number, overlap: number, size: number): Float32Array {
  const stride = window - overlap;
  const own: number[] = [];
  for (let frame = stride + overlap; frame < motion.length / size - 1; frame += stride) own.push(frame);
  return ease(motion, own, stride - overlap, size);
}

/**
 * Eases the borders before the frames `own`, each within at most `longest` frames.
 *
 * The mean of the steps before and after a border extrapolates the motion. Where a bone of the first frame after it is
 * farther from there than twice the mean over the frames after the border, it is rotated back to that distance, and the
 * rotation fades out along a minimum-jerk curve (inertial blending, Bollo 2018).
 */
function ease(motion: Float32Array, own: number[], longest: number, size: number): Float32Array {
  const eased = motion.slice();
  const count = Math.max(1, Math.min(EASE_FRAMES, longest)); // all before the next border
  for (const border of own) {
    const [earlier, before, first, after] = [-2, -1, 0, 1].map((step) => {
      const at = Math.max(border + step, 0) * size;
      return Float64Array.from(motion.subarray(at, at + size));
    });
    const onward = rotate(between(first, before), logMap(first, after));
    const back = logMap(before, earlier);
    const heading = expMap(before, onward.map((value, k) => (value - back[k]) / 2));
    const usual = usualDistances(motion, border, longest, size);
    const off = toVector(between(first, heading));
    const distances = norms(off, 3);
    const rotation = off.map((value, k) => {
      const bone = Math.floor(k / 3);
      return value * Math.max(0, 1 - (TOLERANCE * usual[bone]) / Math.max(distances[bone], 1e-12));
    });
    for (let step = 0; step < count && (border + step) * size < motion.length; step++) {
      const weight = 1 - minimumJerk(step / count);
      const at = (border + step) * size;
      const frame = Float64Array.from(eased.subarray(at, at + size));
      eased.set(rotate(fromVector(rotation.map((value) => weight * value)), frame), at);
    }
  }
  return eased;
}

/**
 * Returns how far each bone is from its extrapolation in the frames after a border, (bones,) radians: the mean length of
 * third differences, halved, over the frames from the second after the border on; 0 where a window has too few of them.
 */
function usualDistances(motion: Float32Array, border: number, longest: number, size: number): Float64Array {
  const last = motion.length / size - 1;
  const at = (frame: number, k: number) => motion[Math.min(border + frame, last) * size + k];
  return Float64Array.from({ length: size / 3 }, (_, bone) => {
    let sum = 0;
    for (let frame = 0; frame + 3 < longest; frame++) {
      const third = [0, 1, 2].map((axis) => {
        const k = 3 * bone + axis;
        return at(frame + 3, k) - 3 * at(frame + 2, k) + 3 * at(frame + 1, k) - at(frame, k);
      });
      sum += Math.hypot(...third) / 2;
    }
    return sum / Math.max(longest - 3, 1);
  });
}

/** Returns a window whose first frames go over from those that were expected, with weights 1/(n+1), ..., n/(n+1). */
function fade(expected: Float32Array, window: Float32Array, frames: number, size: number): Float32Array {
  const faded = window.slice();
  for (let frame = 0; frame < frames; frame++) {
    const [start, end] = [frame * size, (frame + 1) * size];
    const weight = (frame + 1) / (frames + 1);
    faded.set(slerp(expected.subarray(start, end), window.subarray(start, end), weight), start);
  }
  return faded;
}

/**
 * Windows that come one after the other, each `hop` frames later, joined as they come.
 *
 * A window shows the frames from its `first` one on; those before it have been shown. What the window before expected
 * of the first frames that are shown fades out. With a hop of N - M the result is that of `joinWindows` and
 * `easeBorders`.
 */
export class RunningJoin {
  /** Number of the first frame of a window that is shown. */
  readonly first: number;
  private readonly longest: number;
  private readonly isWhole: boolean;
  private readonly fadeFrames: number;
  private shown: Float32Array | undefined;

  /**
   * @param window - frames N of a window.
   * @param overlap - frames M of the seed pose.
   * @param hop - frames from one window to the next, 1 to N - 2 M, or N - M.
   * @param first - number of the first frame that is shown, M to N - hop; not used with a hop of N - M.
   * @param size - numbers in a frame.
   */
  constructor(
    window: number,
    private readonly overlap: number,
    private readonly hop: number,
    first: number,
    private readonly size: number,
  ) {
    this.longest = window - 2 * overlap;
    this.isWhole = hop === window - overlap;
    this.first = this.isWhole ? 0 : first;
    this.fadeFrames = this.isWhole ? overlap : Math.min(hop + 1, overlap, window - this.first - hop);
  }

  /** Lets the next window be joined to nothing, like the first one. */
  restart(): void {
    this.shown = undefined;
  }

  /**
   * Returns the frames that the motion has so far from the first one that this window shows.
   *
   * The first `hop` frames do not change any more; the others change with the next window.
   *
   * @param window - (N, size) unit vectors.
   * @returns (N - first, size) unit vectors.
   */
  add(window: Float32Array): Float32Array {
    const { size, hop } = this;
    let shown: Float32Array = window.slice(this.first * size);
    if (this.shown) {
      const expected = this.shown.subarray(hop * size, (hop + this.fadeFrames) * size);
      shown = fade(expected, shown, this.fadeFrames, size);
      if (this.isWhole) {
        const before = this.shown.subarray(Math.max(hop - 2, 0) * size, hop * size);
        const both = Float32Array.from([...before, ...shown]);
        const border = before.length / size + this.overlap;
        shown = ease(both, [border], this.longest, size).slice(before.length);
      }
    }
    this.shown = shown;
    return shown;
  }
}
