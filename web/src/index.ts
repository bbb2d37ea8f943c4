export type { AudioDescription, Description, Skeleton, Take } from "./description.js";
export { Motion } from "./motion/motion.js";
export { resample } from "./sound/resample.js";
export { readSound } from "./sound/wav.js";
export { Gesturer } from "./synthesis/gesturer.js";
export type { GenerateOptions, LiveStream, LoadOptions, StreamChange, StreamOptions } from "./synthesis/gesturer.js";
export type { StyleOptions } from "./synthesis/style.js";
