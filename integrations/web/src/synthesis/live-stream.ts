/** A stream that computes in the worker. */

import type { Description } from "../description.js";
import { checkEnergy } from "../motion/control/effects.js";
import { checkCue } from "../motion/cues.js";
import { checkState, type State } from "../motion/states.js";
import { checkArray } from "../sound/speech.js";
import type { Frames, Request } from "./messages.js";
import { checkMuted, checkNames, type StreamChange } from "./options.js";
import type { Port } from "./port.js";
import { chooseStyle } from "./style.js";

/** Motion that follows speech, see `Gesturer.stream`. */
export class LiveStream {
  private lastState: State;
  private changes = 0; // of the state

  constructor(
    private readonly port: Port,
    private readonly id: number,
    /** Seconds from a moment of the speech to its frame at most, without the time of the computation. */
    readonly latency: number,
    private readonly description: Description,
    private readonly seed: number,
    state: State,
  ) {
    this.lastState = state;
  }

  /** What the body does where the agent does not speak; "think" becomes "auto" when the agent speaks. */
  get state(): State {
    return this.lastState;
  }

  /**
   * Takes the next samples, and returns the frames that became final; calls are done in their order.
   *
   * @param samples - mono samples of the agent at 16 kHz within -1 and 1, any number of them.
   * @param other - as many samples of the person who is spoken with; silence by default.
   * @returns (n, bones, 3) unit vectors, the frames after those that were returned before; n may be 0.
   */
  async feed(samples: Float32Array, other?: Float32Array): Promise<Float32Array> {
    checkArray(samples);
    if (other) checkArray(other);
    // A part of a longer array is copied here, because the whole would be on its way to the worker.
    return this.frames({ kind: "feed", stream: this.id, samples: samples.slice(), other: other?.slice() });
  }

  /** Ends the stream, and returns the rest of the frames, (n, bones, 3); all frames are round(duration x fps). */
  flush(): Promise<Float32Array> {
    return this.frames({ kind: "flush", stream: this.id });
  }

  /**
   * Changes energy, mute, state or style with the next frames, within half a second; what is not given stays as it is.
   *
   * @throws Error if a value cannot be used.
   */
  change(change: StreamChange): void {
    checkNames(change, "change");
    const { energy = 1, muted = false, state = this.lastState, ...style } = change;
    checkEnergy(energy);
    checkMuted(muted);
    checkState(state);
    chooseStyle(this.description, style, this.seed);
    if (change.state !== undefined) this.changes++;
    this.lastState = state;
    this.port.send({ kind: "change", stream: this.id, change });
  }

  /**
   * Makes a gesture, which is blended into the motion.
   *
   * @param name - one of `description.cues`, such as "nod" or "count:3".
   * @param at - seconds of the motion at which its stroke peaks; by default, and where it is too late, as soon as possible.
   * @throws Error if the model has no such gesture.
   */
  cue(name: string, at?: number): void {
    checkCue(this.description, name, at);
    this.port.send({ kind: "cue", stream: this.id, cue: name, at });
  }

  /**
   * Drops speech that shall not be shown, as that of an agent who is interrupted, and cues that have not begun: the
   * motion goes on from the pose of the frame before, to rest or listening within half a second.
   *
   * @param frame - first frame that shall not be shown, where sound is fed ahead of time; the next sample is heard at its
   *   time. Without it, the agent's sound whose frames were not returned becomes silence, and the next sample keeps its
   *   time.
   * @returns number of the first frame of the next `feed`; frames from it on that were returned should be dropped.
   */
  clear(frame?: number): Promise<number> {
    return this.port.ask({ kind: "clear", stream: this.id, frame });
  }

  /** Ends the stream without its last frames, and frees its memory. */
  close(): void {
    this.port.send({ kind: "close", stream: this.id });
  }

  private async frames(request: Request): Promise<Float32Array> {
    const { changes } = this;
    const { directions, state } = await this.port.ask<Frames>(request);
    if (changes === this.changes) this.lastState = state; // or else it is that before the change
    return directions;
  }
}
