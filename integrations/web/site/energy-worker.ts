/** The worker that makes a motion livelier or calmer, so that a long one does not hold up the page. */

import { applyEnergy } from "../src/motion/energy.js";
import { Motion } from "../src/motion/motion.js";

type Fields = Pick<Motion, "skeleton" | "directions" | "fps" | "meta">;

/** Answers with the directions, and with the meta of the motion. */
self.onmessage = ({ data: { motion, amount } }: MessageEvent<{ motion: Fields; amount: number }>) => {
  const { skeleton, directions, fps, meta } = motion;
  const changed = applyEnergy(new Motion(skeleton, directions, fps, meta), amount);
  self.postMessage({ directions: changed.directions, meta: changed.meta });
};
