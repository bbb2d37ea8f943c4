/** The sample rate that a file of compressed sound states, at which the browser decodes it without resampling. */

// By the version of MPEG: 2.5, none, 2 and 1.
const MP3_RATES = [[11025, 12000, 8000], [], [22050, 24000, 16000], [44100, 48000, 32000]];
const MP3_KBITS = [
  [8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160],
  [32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320],
];
const FALLBACK = 48000; // that of Opus, and of most video

/** Returns samples per second of WAV, MP3, FLAC, Ogg or MP4; 48000 where the file does not say it at its start. */
export function rateOf(bytes: Uint8Array): number {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const stated = wave(bytes, view) ?? flac(bytes, view) ?? vorbis(bytes, view) ?? mp4(bytes, view) ?? mp3(bytes, view);
  const found = stated ?? FALLBACK;
  return found >= 8000 && found <= 96000 ? found : FALLBACK;
}

function indexOf(bytes: Uint8Array, text: string, most: number): number {
  const codes = [...text].map((letter) => letter.charCodeAt(0));
  const last = Math.min(bytes.length, most) - codes.length;
  for (let at = 0; at <= last; at++) if (codes.every((code, i) => bytes[at + i] === code)) return at;
  return -1;
}

function wave(bytes: Uint8Array, view: DataView): number | undefined {
  return indexOf(bytes, "WAVEfmt ", 16) === 8 && bytes.length >= 28 ? view.getUint32(24, true) : undefined;
}

function flac(bytes: Uint8Array, view: DataView): number | undefined {
  const at = indexOf(bytes, "fLaC", 1 << 16);
  return at >= 0 && at + 22 <= bytes.length ? view.getUint32(at + 18) >>> 12 : undefined;
}

function vorbis(bytes: Uint8Array, view: DataView): number | undefined {
  const at = indexOf(bytes, "\x01vorbis", 4096);
  return at >= 0 && at + 16 <= bytes.length ? view.getUint32(at + 12, true) : undefined;
}

function mp4(bytes: Uint8Array, view: DataView): number | undefined {
  if (indexOf(bytes, "ftyp", 12) !== 4) return undefined;
  const at = indexOf(bytes, "mp4a", bytes.length);
  return at >= 0 && at + 30 <= bytes.length ? view.getUint16(at + 28) : undefined;
}

function mp3(bytes: Uint8Array, view: DataView): number | undefined {
  let at = 0;
  if (indexOf(bytes, "ID3", 3) === 0 && bytes.length > 10) {
    at = 10 + ((bytes[6] << 21) | (bytes[7] << 14) | (bytes[8] << 7) | bytes[9]);
  }
  for (const end = Math.min(at + 65536, bytes.length - 4); at < end; at++) {
    const frame = mp3Frame(view, at);
    if (frame && mp3Frame(view, at + frame.length)?.rate === frame.rate) return frame.rate;
  }
  return undefined;
}

/** Returns the rate and the bytes of the frame of layer III that begins at a place; undefined without one. */
function mp3Frame(view: DataView, at: number): { rate: number; length: number } | undefined {
  if (at + 4 > view.byteLength) return undefined;
  const head = view.getUint32(at);
  const version = (head >>> 19) & 3;
  const rate = MP3_RATES[version][(head >>> 10) & 3];
  const kbits = MP3_KBITS[version === 3 ? 1 : 0][((head >>> 12) & 15) - 1];
  if (head >>> 21 !== 0x7ff || ((head >>> 17) & 3) !== 1 || !rate || !kbits) return undefined;
  return { rate, length: Math.floor(((version === 3 ? 144000 : 72000) * kbits) / rate) + ((head >>> 9) & 1) };
}
