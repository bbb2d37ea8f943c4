/**
 * Joining of overlapping windows to one motion, as in `ha2g_jax/motion/windows.py`.
 *
 * Motions and windows are flat arrays (frames, size) with `size` = 3 x bones numbers in a frame.
 */

import { slerp } from "../motion/sphere.js";

/**
 * Returns the frames from one window of a recording to the next, two thirds of the N - M that a window adds.
 *
 * The last frames of a window are generated without the speech that follows. They are generated again by the next one.
 *
 * @param window - frames N of a window.
 * @param overlap - frames M of the seed pose.
 */
export function windowStride(window: number, overlap: number): number {
  return Math.max(1, Math.floor((2 * (window - overlap)) / 3));
}

/**
 * Returns the number of windows that cover a motion.
 *
 * @param frames - frames T of the motion.
 * @param window - frames N of a window.
 * @param stride - frames from one window to the next.
 */
export function numWindows(frames: number, window: number, stride: number): number {
  return Math.max(1, Math.ceil((frames - window) / stride) + 1);
}

/**
 * Joins windows to one motion; what a window expected after the seed pose of the next one fades out there.
 *
 * @param windows - K windows (N, size) of unit vectors.
 * @param overlap - frames M of the seed pose.
 * @param stride - frames from one window to the next, less than N - M.
 * @param size - numbers in a frame.
 * @returns (N + (K - 1) stride, size) unit vectors.
 */
export function joinWindows(windows: Float32Array[], overlap: number, stride: number, size: number): Float32Array {
  const length = windows[0].length;
  const join = new RunningJoin(length / size, overlap, stride, overlap, size);
  const joined = new Float32Array(length + (windows.length - 1) * stride * size);
  joined.set(windows[0].subarray(0, overlap * size));
  windows.forEach((window, index) => joined.set(join.add(window), (index * stride + overlap) * size));
  return joined;
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

const MOST_FADE = 6; // frames, see `windows.py`

/**
 * Windows that come one after the other, each `hop` frames later, joined as they come.
 *
 * A window shows the frames from its `first` one on; those before it have been shown. What the window before expected
 * of the first frames that are shown fades out.
 */
export class RunningJoin {
  private readonly fadeFrames: number;
  private shown: Float32Array | undefined;

  /**
   * @param window - frames N of a window.
   * @param overlap - frames M of the seed pose.
   * @param hop - frames from one window to the next, 1 to N - 2 M.
   * @param first - number of the first frame of a window that is shown, M to N - hop.
   * @param size - numbers in a frame.
   * @param lookAhead - frames of speech that are heard beyond the last of the next `hop` frames.
   */
  constructor(
    window: number,
    overlap: number,
    private readonly hop: number,
    readonly first: number,
    private readonly size: number,
    lookAhead = 0,
  ) {
    let frames = Math.min(hop + 1, overlap);
    if (frames < overlap) frames = Math.max(frames, Math.min(Math.floor((3 * lookAhead) / 4), MOST_FADE));
    this.fadeFrames = Math.min(frames, window - first - hop);
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
    }
    this.shown = shown;
    return shown;
  }
}
