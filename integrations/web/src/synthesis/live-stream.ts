/** A stream that computes in the worker. */

import type { StreamChange } from "./options.js";
import type { Port } from "./port.js";

/** Motion that follows speech, see `Gesturer.stream`. */
export class LiveStream {
  constructor(
    private readonly port: Port,
    private readonly id: number,
    /** Seconds from a moment of the speech to its frame at most, without the time of the computation. */
    readonly latency: number,
    private readonly check: (change: StreamChange) => void,
  ) {}

  /**
   * Takes the next samples, and returns the frames that became final; calls are done in their order.
   *
   * @param samples - mono samples at 16 kHz within -1 and 1, any number of them.
   * @returns (n, bones, 3) unit vectors, the frames after those that were returned before; n may be 0.
   */
  feed(samples: Float32Array): Promise<Float32Array> {
    return this.port.ask({ kind: "feed", stream: this.id, samples });
  }

  /** Ends the stream, and returns the rest of the frames, (n, bones, 3); all frames are round(duration x fps). */
  flush(): Promise<Float32Array> {
    return this.port.ask({ kind: "flush", stream: this.id });
  }

  /**
   * Changes energy, mute or style with the next frames, within half a second; what is not given stays as it is.
   *
   * @throws Error if a value cannot be used.
   */
  change(change: StreamChange): void {
    this.check(change);
    this.port.send({ kind: "change", stream: this.id, change });
  }

  /** Ends the stream without its last frames, and frees its memory. */
  close(): void {
    this.port.send({ kind: "close", stream: this.id });
  }
}
