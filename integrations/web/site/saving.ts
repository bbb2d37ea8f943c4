/** Files of the motion that is shown. */

import type { Motion } from "../src/motion/motion.js";
import { save } from "./elements.js";
import { say } from "./news.js";
import type { Player } from "./player.js";
import { Video } from "./video.js";
import { write } from "./writing.js";

/** Saves a motion as a file of a format, see `write`. */
export async function saveMotion(motion: Motion, stem: string, format: string): Promise<void> {
  const name = `${stem}.${format}`;
  say(`Writing ${name} ...`);
  await new Promise((resolve) => setTimeout(resolve, 30)); // so that the line is seen
  try {
    save(await write(motion, format), name);
    say(`Saved ${name}.`);
  } catch (error) {
    say(`${name} cannot be written: ${(error as Error).message}`, true);
  }
}

/**
 * Plays from the start to the end, and saves a video of it.
 *
 * @param canvas - what is shown.
 * @param begin - is called with the recording, which takes the images.
 * @param goesOn - whether the recording has not been stopped.
 */
export async function saveVideo(
  player: Player,
  canvas: HTMLCanvasElement,
  stem: string,
  begin: (video: Video) => void,
  goesOn: (video: Video) => boolean,
): Promise<void> {
  player.pause();
  player.time = 0;
  const video = new Video(canvas, player.track());
  begin(video);
  say("Recording the video, which takes as long as the sound ...");
  await player.play();
  await player.ended();
  if (!goesOn(video)) return;
  const content = await video.end();
  if (!player.hasEnded) return say("The sound did not play to its end, so no video was saved.", true);
  save(content, `${stem}.webm`);
  say(`Saved ${stem}.webm.`);
}
