/**
 * Rotations as unit quaternions in the order x, y, z, w (that of glTF and three.js).
 *
 * Arrays are flat `Float64Array`s of n quaternions (n x 4) or vectors (n x 3). A function of two arrays repeats the
 * shorter one. `multiply(a, b)` rotates by b first, then by a. A quaternion and its negative are the same rotation.
 */

export type Numbers = Float64Array;

export const IDENTITY: Numbers = Float64Array.of(0, 0, 0, 1);

const MIN_NORM = 1e-12;

/** Repeats `row` `count` times. */
export function tile(row: ArrayLike<number>, count: number): Numbers {
  const rows = new Float64Array(row.length * count);
  for (let k = 0; k < count; k++) rows.set(row, k * row.length);
  return rows;
}

/** Returns the rotations (n x 4) b followed by the rotations a. */
export function multiply(a: Numbers, b: Numbers): Numbers {
  const out = new Float64Array(Math.max(a.length, b.length));
  for (let k = 0; k < out.length; k += 4) {
    const i = k % a.length;
    const j = k % b.length;
    const ax = a[i], ay = a[i + 1], az = a[i + 2], aw = a[i + 3];
    const bx = b[j], by = b[j + 1], bz = b[j + 2], bw = b[j + 3];
    out[k] = aw * bx + ax * bw + ay * bz - az * by;
    out[k + 1] = aw * by - ax * bz + ay * bw + az * bx;
    out[k + 2] = aw * bz + ax * by - ay * bx + az * bw;
    out[k + 3] = aw * bw - ax * bx - ay * by - az * bz;
  }
  return out;
}

/** Returns the inverse rotations (n x 4) of unit quaternions. */
export function conjugate(q: Numbers): Numbers {
  return q.map((value, k) => (k % 4 === 3 ? value : -value));
}

/** Returns the cross products of vectors (n x 3). */
export function cross(a: Numbers, b: Numbers): Numbers {
  const out = new Float64Array(Math.max(a.length, b.length));
  for (let k = 0; k < out.length; k += 3) {
    const i = k % a.length;
    const j = k % b.length;
    out[k] = a[i + 1] * b[j + 2] - a[i + 2] * b[j + 1];
    out[k + 1] = a[i + 2] * b[j] - a[i] * b[j + 2];
    out[k + 2] = a[i] * b[j + 1] - a[i + 1] * b[j];
  }
  return out;
}

/** Returns the dot products (n) of vectors (n x 3). */
export function dot(a: Numbers, b: Numbers): Numbers {
  const out = new Float64Array(Math.max(a.length, b.length) / 3);
  for (let k = 0; k < out.length; k++) {
    const i = (3 * k) % a.length;
    const j = (3 * k) % b.length;
    out[k] = a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];
  }
  return out;
}

/** Returns vectors v (n x 3) rotated by unit quaternions q (n x 4). */
export function rotate(q: Numbers, v: Numbers): Numbers {
  const count = Math.max(q.length / 4, v.length / 3);
  const out = new Float64Array(3 * count);
  for (let k = 0; k < count; k++) {
    const i = (4 * k) % q.length;
    const j = (3 * k) % v.length;
    const qx = q[i], qy = q[i + 1], qz = q[i + 2], qw = q[i + 3];
    const vx = v[j], vy = v[j + 1], vz = v[j + 2];
    const tx = 2 * (qy * vz - qz * vy);
    const ty = 2 * (qz * vx - qx * vz);
    const tz = 2 * (qx * vy - qy * vx);
    out[3 * k] = vx + qw * tx + qy * tz - qz * ty;
    out[3 * k + 1] = vy + qw * ty + qz * tx - qx * tz;
    out[3 * k + 2] = vz + qw * tz + qx * ty - qy * tx;
  }
  return out;
}

/** Returns the lengths (n) of rows of `size` numbers. */
export function norms(rows: Numbers, size: number): Numbers {
  const out = new Float64Array(rows.length / size);
  for (let k = 0; k < rows.length; k++) out[Math.floor(k / size)] += rows[k] * rows[k];
  return out.map(Math.sqrt);
}

/** Returns rows of `size` numbers scaled to length 1; a row of zeros stays as it is. */
export function unit(rows: Numbers, size: number): Numbers {
  const lengths = norms(rows, size);
  return rows.map((value, k) => value / Math.max(lengths[Math.floor(k / size)], MIN_NORM));
}

/** Returns a unit vector at right angles to v (3), the cross product with the axis farthest from it. */
export function perpendicular(v: Numbers): Numbers {
  const sizes = [...v].map(Math.abs);
  const least = new Float64Array(3);
  least[sizes.indexOf(Math.min(...sizes))] = 1;
  return unit(cross(v, least), 3);
}

/**
 * Returns the shortest rotations (n x 4) from vectors u (n x 3) to v (n x 3) of any positive length; between opposite
 * vectors a rotation by 180 degrees about `perpendicular(u)`.
 */
export function between(u: Numbers, v: Numbers): Numbers {
  const from = unit(u, 3);
  const to = unit(v, 3);
  const count = Math.max(from.length, to.length) / 3;
  const middle = new Float64Array(3 * count);
  for (let k = 0; k < count; k++) {
    const a = row(from, k, 3);
    const b = row(to, k, 3);
    const x = a[0] + b[0], y = a[1] + b[1], z = a[2] + b[2];
    const length = Math.sqrt(x * x + y * y + z * z);
    if (length < 1e-7) middle.set(perpendicular(a), 3 * k);
    else middle.set([x / length, y / length, z / length], 3 * k);
  }
  const axis = cross(from, middle);
  const cosine = dot(from, middle);
  const part = (_: unknown, k: number) => (k % 4 === 3 ? cosine[k >> 2] : axis[k - (k >> 2)]);
  return unit(Float64Array.from({ length: 4 * count }, part), 4);
}

/** Returns right-handed rotations (n x 4) about unit axes (n x 3 or 3) by angles (n) in radians. */
export function about(axis: Numbers, angles: Numbers): Numbers {
  const out = new Float64Array(4 * angles.length);
  for (let k = 0; k < angles.length; k++) {
    const sine = Math.sin(angles[k] / 2);
    out.set(row(axis, k, 3).map((value) => value * sine), 4 * k);
    out[4 * k + 3] = Math.cos(angles[k] / 2);
  }
  return out;
}

/** Returns axis-angle vectors (n x 3) of quaternions (n x 4): the axis times the angle in radians, 0 to pi. */
export function toVector(q: Numbers): Numbers {
  const out = new Float64Array((q.length / 4) * 3);
  for (let k = 0; k < q.length / 4; k++) {
    const x = q[4 * k], y = q[4 * k + 1], z = q[4 * k + 2], w = q[4 * k + 3];
    const sign = w < 0 ? -1 : 1;
    const length = Math.sqrt(x * x + y * y + z * z);
    const factor = sign * (length > MIN_NORM ? (2 * Math.atan2(length, sign * w)) / length : 2);
    out[3 * k] = factor * x;
    out[3 * k + 1] = factor * y;
    out[3 * k + 2] = factor * z;
  }
  return out;
}

/** Returns quaternions (n x 4) of axis-angle vectors (n x 3) in radians. */
export function fromVector(vectors: Numbers): Numbers {
  return about(unit(vectors, 3), norms(vectors, 3));
}

/**
 * Returns the twists (n x 4) of rotations q (n x 4) about a unit axis (3), where q is a swing after the twist and the
 * swing is the shortest rotation from the axis to where q takes it. Where q reverses the axis, it is the identity.
 */
export function twist(q: Numbers, axis: Numbers): Numbers {
  const out = new Float64Array(q.length);
  for (let k = 0; k < q.length; k += 4) {
    const along = q[k] * axis[0] + q[k + 1] * axis[1] + q[k + 2] * axis[2];
    const length = Math.sqrt(along * along + q[k + 3] * q[k + 3]);
    const sine = length > 1e-9 ? along / length : 0;
    for (let part = 0; part < 3; part++) out[k + part] = sine * axis[part];
    out[k + 3] = length > 1e-9 ? q[k + 3] / length : 1;
  }
  return out;
}

/** Returns the angles (n) in radians, -pi to pi, of the twists of rotations (n x 4) about a unit axis (3). */
export function twistAngle(q: Numbers, axis: Numbers): Numbers {
  const twists = twist(q, axis);
  const angles = new Float64Array(q.length / 4);
  for (let k = 0; k < angles.length; k++) {
    const sine = twists[4 * k] * axis[0] + twists[4 * k + 1] * axis[1] + twists[4 * k + 2] * axis[2];
    angles[k] = wrapped(2 * Math.atan2(sine, twists[4 * k + 3]));
  }
  return angles;
}

/**
 * Interpolates along the shorter arcs from rotations a (n x 4 or 4) to rotations b (n x 4).
 *
 * @param fractions - (n) positions between them, or one number for all; 0 gives a, 1 gives b.
 */
export function slerp(a: Numbers, b: Numbers, fractions: Numbers | number): Numbers {
  const difference = toVector(multiply(b, conjugate(a)));
  const part = difference.map(
    (value, k) => value * (typeof fractions === "number" ? fractions : fractions[Math.floor(k / 3)]),
  );
  return multiply(fromVector(part), a);
}

/** Returns the angles (n) in radians, 0 to pi, of the rotations from a (n x 4) to b (n x 4). */
export function angleBetween(a: Numbers, b: Numbers): Numbers {
  return norms(toVector(multiply(b, conjugate(a))), 3);
}

/**
 * Chooses the signs of the rotations q (T x 4) of one joint so that they are continuous over time.
 *
 * @param before - the rotation (4) of the frame before; without it w >= 0 in the first frame.
 */
export function continuous(q: Numbers, before?: Numbers): Numbers {
  const out = q.slice();
  const [x, y, z, w] = before ?? IDENTITY;
  let product = x * q[0] + y * q[1] + z * q[2] + w * q[3];
  for (let k = 0; k < out.length; k += 4) {
    if (k) product = out[k] * out[k - 4] + out[k + 1] * out[k - 3] + out[k + 2] * out[k - 2] + out[k + 3] * out[k - 1];
    for (let part = k; product < 0 && part < k + 4; part++) out[part] = -out[part];
  }
  return out;
}

/** Returns row k of an array of rows of `size` numbers, which is repeated if it is shorter. */
export function row(rows: Numbers, k: number, size: number): Numbers {
  const start = (k * size) % rows.length;
  return rows.subarray(start, start + size);
}

/** Returns an angle in radians. */
export function radians(degrees: number): number {
  return (degrees / 180) * Math.PI;
}

/** Returns an angle in radians within -pi and pi. */
export function wrapped(angle: number): number {
  const turn = 2 * Math.PI;
  return ((((angle + Math.PI) % turn) + turn) % turn) - Math.PI;
}
