/** Views of bytes, bytes of numbers, and joining of bytes. */

/** Returns a view of bytes, which may be those of a Node Buffer, or of an array of another realm. */
export function bytesOf(bytes: ArrayBuffer | Uint8Array): Uint8Array {
  if (!ArrayBuffer.isView(bytes)) return new Uint8Array(bytes);
  return new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** Returns the bytes of numbers as little-endian float32. */
export function floatBytes(values: ArrayLike<number>): Uint8Array {
  const view = new DataView(new ArrayBuffer(4 * values.length));
  for (let k = 0; k < values.length; k++) view.setFloat32(4 * k, values[k], true);
  return new Uint8Array(view.buffer);
}

/** Joins arrays of bytes to one. */
export function joinBytes(parts: Uint8Array[]): Uint8Array<ArrayBuffer> {
  const joined = new Uint8Array(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    joined.set(part, at);
    at += part.length;
  }
  return joined;
}
