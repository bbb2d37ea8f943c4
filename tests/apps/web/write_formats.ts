// Writes the formats of the web package for a motion that Python stored, and prints joint rotations as JSON.
// node write_formats.mjs MOTION.json FIGURE.glb FOLDER

import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { writeBvh } from "../../../integrations/web/src/formats/bvh.js";
import { writeGlb } from "../../../integrations/web/src/formats/glb.js";
import { writeNpz } from "../../../integrations/web/src/formats/npz.js";
import { Motion } from "../../../integrations/web/src/motion/motion.js";
import { LivePoses, localRotations, retarget } from "../../../integrations/web/src/motion/poses.js";

const [input, figure, folder] = process.argv.slice(2);
const { skeleton, directions, fps, meta } = JSON.parse(readFileSync(input, "utf-8"));
const motion = new Motion(skeleton, Float32Array.from(directions), fps, meta);
writeFileSync(join(folder, "web.npz"), writeNpz(motion));
writeFileSync(join(folder, "web.bvh"), writeBvh(motion));
writeFileSync(join(folder, "web.glb"), writeGlb(motion, readFileSync(figure)));

const live = new LivePoses(skeleton, fps, "ha2g");
const size = 3 * skeleton.bones.length;
const pieces: number[] = [];
for (let frame = 0; frame < motion.numFrames; frame += 4) {
  pieces.push(...live.animate(motion.directions.subarray(size * frame, size * (frame + 4))).rotations);
}
const rotations = {
  ha2g: [...localRotations(motion)],
  mixamo: [...retarget(motion, "mixamo").rotations],
  vrm: [...retarget(motion, "vrm").rotations],
  live: pieces,
};
console.log(JSON.stringify(rotations));
