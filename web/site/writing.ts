/** Files of motion for other programs. */

import { writeBvh } from "../src/formats/bvh.js";
import { writeGlb } from "../src/formats/glb.js";
import { writeNpz } from "../src/formats/npz.js";
import type { Motion } from "../src/motion/motion.js";

/** Returns a motion as a file of a format: npz, bvh or glb. */
export async function write(motion: Motion, format: string): Promise<Blob> {
  const writers: Record<string, (motion: Motion) => Uint8Array | Promise<Uint8Array>> = {
    npz: writeNpz,
    bvh: writeBvh,
    glb: writeGlb,
  };
  return new Blob([(await writers[format](motion)) as Uint8Array<ArrayBuffer>]);
}
