/** The files have the structure that their formats prescribe; tests/apps/web/test_formats.py compares them with Python's. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { writeBvh } from "../src/formats/bvh.js";
import { readContainer, writeContainer } from "../src/formats/container.js";
import { writeGlb } from "../src/formats/glb.js";
import { writeNpz } from "../src/formats/npz.js";
import { crc32, writeZip } from "../src/formats/zip.js";
import { makeMotion } from "./fixtures/motion.js";

const bytesOf = (text: string) => new TextEncoder().encode(text);

test("the checksum of a zip is that of its standard", () => {
  assert.equal(crc32(bytesOf("123456789")), 0xcbf43926);
});

test("an archive ends with a directory of its files", () => {
  const zip = writeZip({ "a.npy": bytesOf("one"), "b.npy": bytesOf("three") });
  const view = new DataView(zip.buffer);
  const end = zip.length - 22;
  assert.equal(view.getUint32(end, true), 0x06054b50);
  assert.equal(view.getUint16(end + 10, true), 2);
  const start = view.getUint32(end + 16, true);
  assert.equal(view.getUint32(start, true), 0x02014b50);
  assert.equal(start + view.getUint32(end + 12, true), end);
});

test("the data of an array begin at a multiple of 64 bytes of its file", () => {
  const text = new TextDecoder("latin1").decode(writeNpz(makeMotion()));
  const start = text.indexOf("\x93NUMPY");
  assert.equal((text.indexOf("\n", start) + 1 - start) % 64, 0);
  assert.match(text.slice(start, start + 200), /'descr': '<f4', 'fortran_order': False, 'shape': \(12, 42, 3\)/);
});

test("each line of motion of a BVH has a value for each channel", async () => {
  const lines = (await new Blob([writeBvh(makeMotion())]).text()).trimEnd().split("\n");
  const counts = lines.flatMap((line) => /CHANNELS (\d)/.exec(line)?.[1] ?? []).map(Number);
  const channels = counts.reduce((sum, count) => sum + count, 0);
  const start = lines.indexOf("MOTION");
  assert.deepEqual(lines.slice(start + 1, start + 3), ["Frames: 12", "Frame Time: 0.0666666667"]);
  assert.equal(lines.length, start + 3 + 12);
  for (const line of lines.slice(start + 3)) assert.equal(line.split(" ").length, channels);
});

test("a container gives its parts back, and is refused when it is cut short", () => {
  const file = writeContainer({ name: "ä" }, Uint8Array.of(1, 2, 3));
  assert.equal(file.length % 4, 0);
  const { json, blob } = readContainer(file);
  assert.deepEqual([json, [...blob]], [{ name: "ä" }, [1, 2, 3, 0]]);
  for (let length = 0; length < file.length; length++) {
    assert.throws(() => readContainer(file.slice(0, length)), /GLB file/);
  }
  assert.throws(() => readContainer(file, 8), /more than 8 bytes/);
});

test("a figure with other joints than the motion is refused", () => {
  const figure = { accessors: [], bufferViews: [], nodes: [{ name: "spine", translation: [0, 0, 0] }] };
  const file = writeContainer(figure, new Uint8Array());
  for (const bytes of [file, file.slice().buffer, Buffer.concat([Buffer.alloc(9), file]).subarray(9)]) {
    assert.throws(() => writeGlb(makeMotion(), bytes), /no joint neck/);
  }
});
