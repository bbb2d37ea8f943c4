/** Runs in the thread of the audio: sends the mean of the channels, from sample number `start` on, in pieces. */

declare const currentFrame: number;
declare class AudioWorkletProcessor {
  readonly port: MessagePort;
}
declare function registerProcessor(name: string, processor: unknown): void;

class Capture extends AudioWorkletProcessor {
  private readonly start: number;
  private readonly size: number;
  private piece: Float32Array<ArrayBuffer>;
  private count = 0;

  constructor({ processorOptions }: { processorOptions: { start: number; size: number } }) {
    super();
    this.start = processorOptions.start;
    this.size = processorOptions.size;
    this.piece = new Float32Array(this.size);
  }

  process([channels]: Float32Array[][]): boolean {
    for (let i = Math.max(this.start - currentFrame, 0); i < 128; i++) {
      let sample = 0;
      for (const channel of channels) sample += channel[i] / channels.length;
      this.piece[this.count++] = sample;
      if (this.count < this.size) continue;
      this.port.postMessage(this.piece, [this.piece.buffer]);
      this.piece = new Float32Array(this.size); // the other one is given away
      this.count = 0;
    }
    return true;
  }
}

registerProcessor("capture", Capture);
