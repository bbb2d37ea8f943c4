/** Least-squares fit of a rotation to several directions. */

import { row, type Numbers } from "./rotations.js";

/** Cyclic sweeps of Jacobi's method, at most; a matrix of 4 x 4 needs four or five. */
const SWEEPS = 12;
/** Below this a number outside of the diagonal is zero; the matrix is of unit vectors. */
const ZERO = 1e-17;

/**
 * Fits the rotations from directions at rest to observed directions by least squares (Wahba's problem).
 *
 * The quaternion is the eigenvector of the largest eigenvalue of Davenport's matrix. With the singular values s of
 * sum seen rest^T, the two largest eigenvalues differ by 2 (s_2 + s_3), s_3 negative for a reflection (F. L. Markley,
 * "Attitude determination using vector observations and the singular value decomposition", 1988).
 *
 * @param seen - (T x 3) unit vectors of each observed direction.
 * @param rest - (3,) unit vector of each of the directions at rest.
 * @returns (T x 4) rotations with w >= 0, and (T) certainties from 0, where all directions lie on one line, to 1, where
 *   they lie to each other as at rest.
 */
export function fit(seen: Numbers[], rest: Numbers[]): { fitted: Numbers; certainty: Numbers } {
  const count = seen[0].length / 3;
  const fitted = new Float64Array(4 * count);
  const certainty = new Float64Array(count);
  const spread = largest(davenport(rest, rest)).gap;
  for (let k = 0; k < count; k++) {
    const { vector, gap } = largest(davenport(seen.map((vectors) => row(vectors, k, 3)), rest));
    fitted.set(vector[3] < 0 ? vector.map((value) => -value) : vector, 4 * k);
    certainty[k] = Math.min(Math.max(gap / spread, 0), 1);
  }
  return { fitted, certainty };
}

/** Returns the matrix (4 x 4) of sum seen rest^T whose eigenvector is the quaternion x, y, z, w. */
function davenport(seen: Numbers[], rest: Numbers[]): number[][] {
  const b = [0, 1, 2].map((i) => [0, 1, 2].map((j) => rest.reduce((sum, r, n) => sum + seen[n][i] * r[j], 0)));
  const trace = b[0][0] + b[1][1] + b[2][2];
  const z = [b[2][1] - b[1][2], b[0][2] - b[2][0], b[1][0] - b[0][1]];
  const rows = b.map((values, i) => [...values.map((value, j) => value + b[j][i] - (i === j ? trace : 0)), z[i]]);
  return [...rows, [...z, trace]];
}

/** Returns the eigenvector of the largest eigenvalue of a symmetric matrix (4 x 4), and its distance to the second. */
function largest(matrix: number[][]): { vector: number[]; gap: number } {
  const a = matrix.map((values) => [...values]);
  const vectors = a.map((_, i) => a.map((_, j) => Number(i === j)));
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    let isDone = true;
    for (let p = 0; p < 3; p++) for (let q = p + 1; q < 4; q++) if (eliminate(a, vectors, p, q)) isDone = false;
    if (isDone) break;
  }
  const order = [0, 1, 2, 3].sort((i, j) => a[j][j] - a[i][i]);
  return { vector: vectors.map((values) => values[order[0]]), gap: a[order[0]][order[0]] - a[order[1]][order[1]] };
}

/** Rotates in the plane of p and q so that a[p][q] becomes 0, and returns whether it was another number. */
function eliminate(a: number[][], vectors: number[][], p: number, q: number): boolean {
  if (Math.abs(a[p][q]) < ZERO) return false;
  const theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
  const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.sqrt(theta * theta + 1));
  const c = 1 / Math.sqrt(t * t + 1);
  const s = t * c;
  for (const values of [...a, ...vectors]) {
    const first = values[p];
    values[p] = c * first - s * values[q];
    values[q] = s * first + c * values[q];
  }
  for (let k = 0; k < 4; k++) {
    const first = a[p][k];
    a[p][k] = c * first - s * a[q][k];
    a[q][k] = s * first + c * a[q][k];
  }
  return true;
}
