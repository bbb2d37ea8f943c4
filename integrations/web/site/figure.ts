/** The figure of the viewer, which shows a whole motion, or frames while they arrive. */

import type { Skeleton } from "../src/description.js";
import { restPose } from "../src/motion/control/parts.js";
import type { Motion } from "../src/motion/motion.js";
import { exportAxes } from "../src/motion/rest.js";

export class ShownFigure extends ArrivingMotion {
  private isWhole = false;

  /**
   * @param skeleton - skeleton of the model.
   * @param fps - frames per second.
   * @param body - contents of model/body.json.
   */
  constructor(skeleton: Skeleton, fps: number, body: object) {
    const { joints, bones, lengths } = skeleton;
    const [rest, axes] = [restPose(skeleton), exportAxes(skeleton)].map((values) => Array.from(values));
    super({ joints, bones, lengths, fps, rest, axes, body });
  }

  /** Goes to a whole motion within a moment. */
  present(motion: Motion): void {
    const size = 3 * this.bones.length;
    this.ease();
    this.isWhole = true;
    this.frames = Array.from({ length: motion.numFrames }, (_, number) => {
      return { number, directions: this.read(motion.directions.subarray(size * number, size * (number + 1))) };
    });
  }

  /** The pose that was drawn last, (bones, 3) unit vectors in the axes of the skeleton. */
  get directions(): Float32Array {
    return this.read(this.pose).map((value, i, all) => {
      const bone = 3 * Math.floor(i / 3);
      return value / (Math.hypot(all[bone], all[bone + 1], all[bone + 2]) || 1);
    });
  }

  override clear(): void {
    this.isWhole = false;
    super.clear();
  }

  override around(number: number): ReturnType<ArrivingMotion["around"]> {
    if (!this.isWhole) return super.around(number);
    const shown = Math.min(Math.max(number, 0), this.frames.length - 1);
    const frame = Math.floor(shown + 1e-4); // a time that is a frame but for rounding errors is that frame
    const [a, b] = [this.frames[frame], this.frames[Math.min(frame + 1, this.frames.length - 1)]];
    return { a, b, weight: Math.max(shown - frame, 0), shown };
  }
}
