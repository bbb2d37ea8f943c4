/** The `.npz` file of a motion, which Python's `Motion.load` and every `ha2g` command read. */

import type { Motion } from "../motion/motion.js";
import { floatBytes, joinBytes } from "./bytes.js";
import { writeZip } from "./zip.js";

const ALIGNMENT = 64; // of the data of an array, as NumPy's

/**
 * Writes a motion as a NumPy archive of directions, positions, fps, joint_names and meta (JSON text).
 *
 * @param motion - motion to write.
 * @returns bytes of the file; the same motion gives the same bytes.
 */
export function writeNpz(motion: Motion): Uint8Array<ArrayBuffer> {
  const { skeleton, numFrames } = motion;
  const { joints, bones } = skeleton;
  const meta = JSON.stringify(motion.meta, null, 1);
  return writeZip({
    "directions.npy": array("<f4", [numFrames, bones.length, 3], floatBytes(motion.directions)),
    "positions.npy": array("<f4", [numFrames, joints.length, 3], floatBytes(motion.positions())),
    "fps.npy": array("<f8", [], doubles([motion.fps])),
    "joint_names.npy": texts(joints, [joints.length]),
    "meta.npy": texts([meta], []),
  });
}

/** Returns a `.npy` file, version 1.0, of values in the order of C. */
function array(type: string, shape: number[], data: Uint8Array): Uint8Array {
  const sizes = shape.length === 1 ? `${shape[0]},` : shape.join(", ");
  const header = `{'descr': '${type}', 'fortran_order': False, 'shape': (${sizes}), }`;
  const length = Math.ceil((10 + header.length + 1) / ALIGNMENT) * ALIGNMENT - 10;
  const start = Uint8Array.of(0x93, ...new TextEncoder().encode("NUMPY"), 1, 0, length & 0xff, length >> 8);
  return joinBytes([start, new TextEncoder().encode(`${header.padEnd(length - 1)}\n`), data]);
}

/** Returns an array of texts, each as code points of four bytes, filled up with zeros. */
function texts(values: string[], shape: number[]): Uint8Array {
  const points = values.map((value) => Array.from(value, (letter) => letter.codePointAt(0) ?? 0));
  const length = Math.max(1, ...points.map((letters) => letters.length));
  const view = new DataView(new ArrayBuffer(4 * length * values.length));
  points.forEach((letters, row) => letters.forEach((point, k) => view.setUint32(4 * (length * row + k), point, true)));
  return array(`<U${length}`, shape, new Uint8Array(view.buffer));
}

function doubles(values: number[]): Uint8Array {
  const view = new DataView(new ArrayBuffer(8 * values.length));
  values.forEach((value, k) => view.setFloat64(8 * k, value, true));
  return new Uint8Array(view.buffer);
}
