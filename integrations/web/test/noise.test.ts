/** The noise has the numbers of Python, see `tests/features/test_noise.py`. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { noiseTrack } from "../src/sound/noise.js";

test("the numbers are those of Python", () => {
  const found = [-4, 96, 296].flatMap((frame) => [...noiseTrack(3, frame, 1, 15, 2)]);
  const other = noiseTrack(2 ** 32 - 1, 0, 2, 15, 3).subarray(3);
  const expected = [0.5156042, 0.23819974, -0.90501124, 2.7902267, -1.7358935, -0.07637546];
  [...expected, 0.18276846, 1.235434, 0.07706467].forEach((value, k) => {
    assert.ok(Math.abs([...found, ...other][k] - value) < 1e-6);
  });
});
