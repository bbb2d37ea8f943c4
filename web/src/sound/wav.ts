/** Reader of WAV files. */

/**
 * Reads a WAV file as mono samples at 16 kHz; channels are averaged.
 *
 * @param bytes - contents of the file.
 * @returns (samples,) at 16 kHz.
 * @throws Error if it is no WAV file of PCM or floating-point samples, or shorter than 0.2 s.
 */
export function readSound(bytes: ArrayBuffer): Float32Array {
  throw new Error(`not built yet: ${bytes}`);
}
