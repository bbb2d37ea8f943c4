/** Sizes of images by their first bytes. */

/**
 * Returns width and height of a PNG or JPEG image in pixels, undefined for other formats and damaged images.
 *
 * @param bytes - contents of the file.
 */
export function imageSize(bytes: Uint8Array): [number, number] | undefined {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length >= 24 && view.getUint32(0) === 0x89504e47) return [view.getUint32(16), view.getUint32(20)];
  if (bytes.length < 4 || view.getUint16(0) !== 0xffd8) return undefined;
  // Segments of a JPEG: a marker, then a length that counts itself. The size is in the start of frame.
  for (let at = 2; at + 9 <= bytes.length; ) {
    const marker = view.getUint16(at);
    if (marker >= 0xffc0 && marker <= 0xffcf && ![0xffc4, 0xffc8, 0xffcc].includes(marker)) {
      return [view.getUint16(at + 7), view.getUint16(at + 5)];
    }
    if (marker < 0xff02 || (marker >= 0xffd0 && marker <= 0xffd9)) return undefined; // none, or one without a length
    at += marker === 0xffff ? 1 : 2 + view.getUint16(at + 2); // bytes 0xff before a marker fill up
  }
  return undefined;
}
