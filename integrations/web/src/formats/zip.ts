/** Writer of zip archives without compression. */

import { joinBytes } from "./bytes.js";

const VERSION = 20;
const UTF8_NAMES = 0x800;
const FIRST_DAY = 0x21; // 1 January 1980, so that the same contents give the same bytes

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit++) value = value & 1 ? 0xedb88320 ^ (value >>> 1) : value >>> 1;
  return value;
});

/**
 * Writes an archive.
 *
 * @param files - contents by name, all together below 4 GiB.
 */
export function writeZip(files: Record<string, Uint8Array>): Uint8Array<ArrayBuffer> {
  const parts: Uint8Array[] = [];
  const directory: Uint8Array[] = [];
  let offset = 0;
  for (const [name, bytes] of Object.entries(files)) {
    const encoded = new TextEncoder().encode(name);
    // Version, flags, method, time, date, checksum, two sizes, length of the name and of further fields.
    const facts = [VERSION, UTF8_NAMES, 0, 0, FIRST_DAY, crc32(bytes), bytes.length, bytes.length, encoded.length, 0];
    const local = record("42222244422", [0x04034b50, ...facts]);
    const central = record("42222224442222244", [0x02014b50, VERSION, ...facts, 0, 0, 0, 0, offset]);
    parts.push(local, encoded, bytes);
    directory.push(central, encoded);
    offset += local.length + encoded.length + bytes.length;
  }
  const size = directory.reduce((sum, { length }) => sum + length, 0);
  const count = Object.keys(files).length;
  const end = record("42222442", [0x06054b50, 0, 0, count, count, size, offset, 0]);
  return joinBytes([...parts, ...directory, end]);
}

/** Returns the checksum of the zip format. */
export function crc32(bytes: Uint8Array): number {
  let value = 0xffffffff;
  for (const byte of bytes) value = CRC_TABLE[(value ^ byte) & 0xff] ^ (value >>> 8);
  return (value ^ 0xffffffff) >>> 0;
}

/** Returns numbers as little-endian fields of the given widths, 2 or 4 bytes. */
function record(widths: string, values: number[]): Uint8Array {
  return Uint8Array.from(
    values.flatMap((value, k) => Array.from({ length: Number(widths[k]) }, (_, byte) => (value >>> (8 * byte)) & 0xff)),
  );
}
