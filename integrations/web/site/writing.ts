/** Files of motion for other programs. */

import { writeBvh } from "../src/formats/bvh.js";
import { writeGlb } from "../src/formats/glb.js";
import { writeNpz } from "../src/formats/npz.js";
import type { Motion } from "../src/motion/motion.js";
import { fileOf } from "./elements.js";

/** Returns a motion as a file of a format: npz, bvh or glb. */
export async function write(motion: Motion, format: string): Promise<Blob> {
  const bytes =
    format === "npz" ? writeNpz(motion) : format === "bvh" ? writeBvh(motion) : writeGlb(motion, await loadFigure());
  return new Blob([bytes]);
}

/** Returns the body of a GLB file. */
async function loadFigure(): Promise<Uint8Array> {
  const response = await fetch(fileOf("model/figure.glb"));
  if (!response.ok) throw new Error(`figure.glb is missing (${response.status})`);
  return new Uint8Array(await response.arrayBuffer());
}
