/** Fit of one rotation to several vectors. */

import type { Numbers } from "../rotations.js";

const SWEEPS = 20; // at most; a few are enough
const SMALL = 1e-30; // square of what is left beside the diagonal

/**
 * Fits rotations of vectors by least squares (Wahba 1965), by the quaternions of Davenport's method.
 *
 * @param references - k vectors (3).
 * @param tracks - k arrays (T x 3), the vectors that these are rotated to.
 * @returns unit quaternions (T x 4) with w >= 0.
 */
export function commonRotation(references: Numbers[], tracks: Numbers[]): Numbers {
  const rotations = new Float64Array((tracks[0].length / 3) * 4);
  for (let frame = 0; frame < rotations.length / 4; frame++) {
    const b = Array.from({ length: 9 }, (_, k) => {
      return tracks.reduce((sum, track, n) => sum + track[3 * frame + Math.floor(k / 3)] * references[n][k % 3], 0);
    });
    const trace = b[0] + b[4] + b[8];
    const [x, y, z] = [b[7] - b[5], b[2] - b[6], b[3] - b[1]];
    const fitted = largestEigenvector([
      [2 * b[0] - trace, b[1] + b[3], b[2] + b[6], x],
      [b[1] + b[3], 2 * b[4] - trace, b[5] + b[7], y],
      [b[2] + b[6], b[5] + b[7], 2 * b[8] - trace, z],
      [x, y, z, trace],
    ]);
    rotations.set(fitted[3] < 0 ? fitted.map((value) => -value) : fitted, 4 * frame);
  }
  return rotations;
}

/** Returns the unit eigenvector of the largest eigenvalue of a symmetric matrix, by Jacobi's method. */
function largestEigenvector(matrix: number[][]): number[] {
  const size = matrix.length;
  const vectors = matrix.map((_, row) => matrix.map((_, column) => (row === column ? 1 : 0)));
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    let rest = 0;
    for (let p = 0; p < size; p++) {
      for (let q = p + 1; q < size; q++) {
        rest += matrix[p][q] ** 2;
        rotatePlane(matrix, vectors, p, q);
      }
    }
    if (rest < SMALL) break;
  }
  const values = matrix.map((row, k) => row[k]);
  const largest = values.indexOf(Math.max(...values));
  return vectors.map((row) => row[largest]);
}

/** Rotates a symmetric matrix and its vectors in the plane of two axes, so that their common entry is 0, in place. */
function rotatePlane(matrix: number[][], vectors: number[][], p: number, q: number): void {
  if (matrix[p][q] === 0) return;
  const ratio = (matrix[q][q] - matrix[p][p]) / (2 * matrix[p][q]);
  const tangent = (ratio < 0 ? -1 : 1) / (Math.abs(ratio) + Math.sqrt(ratio * ratio + 1));
  const cosine = 1 / Math.sqrt(tangent * tangent + 1);
  const sine = tangent * cosine;
  for (const row of [...matrix, ...vectors]) {
    [row[p], row[q]] = [cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]];
  }
  const [first, second] = [matrix[p], matrix[q]];
  for (let k = 0; k < first.length; k++) {
    [first[k], second[k]] = [cosine * first[k] - sine * second[k], sine * first[k] + cosine * second[k]];
  }
}
