/** The energy of the motion that is shown. */

import { Motion } from "../src/motion/motion.js";
import { fileOf } from "./elements.js";

/** Changes the energy of motions, one at a time; of requests that come meanwhile only the last is done. */
export class Energy {
  private worker: Worker | null = null;
  private next: { motion: Motion; amount: number } | null = null;
  private isBusy = false;

  /**
   * @param ondone - is called with a motion that has the energy that was asked for last.
   * @param onfail - is called with the motion as it was if its energy cannot be changed.
   */
  constructor(
    private readonly ondone: (motion: Motion) => void,
    private readonly onfail: (motion: Motion) => void,
  ) {}

  /** Whether a motion was asked for that is not there yet. */
  get isPending(): boolean {
    return this.isBusy;
  }

  /** Asks for a motion, whose energy is 1, with another energy. */
  ask(motion: Motion, amount: number): void {
    this.next = { motion, amount };
    if (!this.isBusy) this.step();
  }

  private step(): void {
    const { next } = this;
    if (!next) return;
    this.next = null;
    if (next.amount === 1) return this.ondone(next.motion);
    this.isBusy = true;
    this.worker ??= new Worker(fileOf("energy.js"), { type: "module" });
    this.worker.onmessage = ({ data: { directions, meta } }: MessageEvent<Pick<Motion, "directions" | "meta">>) => {
      this.isBusy = false;
      if (this.next) this.step();
      else this.ondone(new Motion(next.motion.skeleton, directions, next.motion.fps, meta));
    };
    this.worker.onerror = () => {
      this.worker?.terminate();
      this.worker = null;
      this.isBusy = false;
      const { motion } = this.next ?? next;
      this.next = null;
      this.onfail(motion);
    };
    this.worker.postMessage(next);
  }
}
