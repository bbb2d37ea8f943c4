/** The binary container of glTF: a JSON text and bytes. */

import { joinBytes } from "./bytes.js";

const MAGIC = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const BINARY_CHUNK = 0x004e4942;

/** A glTF document of which nothing is known but that it is an object. */
export type Json = Record<string, unknown>;

/**
 * Reads a `.glb` file of version 2.
 *
 * @param bytes - contents of the file.
 * @param maxText - bytes that the JSON text may have.
 * @returns its JSON object and its bytes, empty without any.
 * @throws Error if it is no complete `.glb` file.
 */
export function readContainer(bytes: Uint8Array, maxText = Infinity): { json: Json; blob: Uint8Array } {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 20 || view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== 2) {
    throw new Error("the file is not a GLB file of glTF 2.0");
  }
  const textEnd = 20 + view.getUint32(12, true);
  if (view.getUint32(8, true) !== bytes.length || view.getUint32(16, true) !== JSON_CHUNK || textEnd > bytes.length) {
    throw new Error("the GLB file is damaged or not complete");
  }
  if (textEnd - 20 > maxText) throw new Error(`the JSON text of the GLB file has more than ${maxText} bytes`);
  let blob: Uint8Array = new Uint8Array();
  if (textEnd + 8 <= bytes.length) {
    const length = view.getUint32(textEnd, true);
    if (view.getUint32(textEnd + 4, true) !== BINARY_CHUNK || textEnd + 8 + length > bytes.length) {
      throw new Error("the GLB file is damaged or not complete");
    }
    blob = bytes.subarray(textEnd + 8, textEnd + 8 + length);
  }
  return { json: parse(bytes.subarray(20, textEnd)), blob };
}

/** Writes a `.glb` file. */
export function writeContainer(json: Json, blob: Uint8Array): Uint8Array<ArrayBuffer> {
  const encoded = new TextEncoder().encode(JSON.stringify(json));
  const text = joinBytes([encoded, new Uint8Array(-encoded.length & 3).fill(0x20)]);
  const data = joinBytes([blob, new Uint8Array(-blob.length & 3)]);
  const length = 28 + text.length + data.length;
  const start = words([MAGIC, 2, length, text.length, JSON_CHUNK]);
  return joinBytes([start, text, words([data.length, BINARY_CHUNK]), data]);
}

function parse(bytes: Uint8Array): Json {
  let value: unknown;
  try {
    value = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
  } catch (error) {
    throw new Error("the JSON text of the GLB file cannot be read", { cause: error });
  }
  if (typeof value !== "object" || value === null || Array.isArray(value)) {
    throw new Error("the JSON text of the GLB file is not an object");
  }
  return value as Json;
}

function words(values: number[]): Uint8Array {
  const view = new DataView(new ArrayBuffer(4 * values.length));
  values.forEach((value, k) => view.setUint32(4 * k, value, true));
  return new Uint8Array(view.buffer);
}
