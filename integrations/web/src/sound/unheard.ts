/** The end of a window that has not been heard yet, as training and a stream hide it. */

import { NUM_MELS, windowColumn, windowColumns } from "./mel.js";

const HIDDEN_DB = 0; // in all bands of a hidden column; no sound has the maximum of a clip in every band

/**
 * Hides the columns of a window that need speech from after its first frames, in place.
 *
 * @param mel - (128, columns) dB of a window.
 * @param startFrame - first frame of the window in its clip.
 * @param heard - number of frames of the window whose time has passed.
 * @param fps - frames per second.
 */
export function hideUnheard(mel: Float32Array, startFrame: number, heard: number, fps: number): void {
  const columns = mel.length / NUM_MELS;
  const known = Math.max(windowColumns(startFrame + heard, fps) - windowColumn(startFrame, fps), 0);
  for (let band = 0; band < NUM_MELS && known < columns; band++) {
    mel.fill(HIDDEN_DB, band * columns + known, (band + 1) * columns);
  }
}
