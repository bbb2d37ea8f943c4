/** The microphone, at 16 kHz. */

import { fileOf } from "./elements.js";
import { RunningResampler } from "../src/sound/running-resampler.js";

const PIECE = 0.04; // seconds of sound that arrive together
const ENDED = "The microphone gives no more sound; is it still connected, and allowed for this page?";
const REASONS: Record<string, string> = {
  NotAllowedError: "The microphone may not be used; allow it for this page in the browser.",
  NotFoundError: "There is no microphone.",
};

export class Microphone {
  private start = 0;

  private constructor(
    private readonly context: AudioContext,
    private readonly stream: MediaStream,
  ) {}

  /** Opens the microphone; throws an error with a sentence for people. */
  static async open(): Promise<Microphone> {
    if (!window.AudioWorkletNode || !navigator.mediaDevices) {
      throw new Error("Browsers give the microphone to pages of https:// and of this computer (localhost) only.");
    }
    const context = new AudioContext({ latencyHint: "interactive" });
    try {
      const resumed = context.resume(); // at once, as browsers allow it after a click only
      const audio = { channelCount: 1, echoCancellation: false };
      const stream = await navigator.mediaDevices.getUserMedia({ audio }).catch((error: DOMException) => {
        throw new Error(REASONS[error.name] ?? `The microphone cannot be used: ${error.message}`);
      });
      const microphone = new Microphone(context, stream);
      await context.audioWorklet.addModule(fileOf("capture.js")).catch((error: Error) => {
        microphone.close();
        throw error;
      });
      await resumed;
      return microphone;
    } catch (error) {
      if (context.state !== "closed") void context.close();
      throw error;
    }
  }

  /** Takes the sound from now on; `take` gets samples at 16 kHz, `onend` is called when no more can come. */
  begin(take: (samples: Float32Array) => void, onend: (reason: string) => void): void {
    const { context } = this;
    for (const track of this.stream.getTracks()) {
      track.onended = () => onend(ENDED);
      if (track.readyState === "ended") queueMicrotask(() => onend(ENDED)); // it ended before this was called
    }
    const start = Math.ceil((context.currentTime + 0.1) * context.sampleRate);
    const size = Math.round(PIECE * context.sampleRate);
    const resampler = new RunningResampler(context.sampleRate);
    const capture = new AudioWorkletNode(context, "capture", { processorOptions: { start, size } });
    capture.port.onmessage = ({ data }: MessageEvent<Float32Array>) => take(resampler.push(data));
    const source = new MediaStreamAudioSourceNode(context, { mediaStream: this.stream });
    source.connect(capture).connect(context.destination); // its output is silent
    this.start = start / context.sampleRate;
  }

  /** Seconds since the first sample that was taken. */
  get time(): number {
    return this.context.currentTime - this.start;
  }

  close(): void {
    for (const track of this.stream.getTracks()) track.stop();
    void this.context.close();
  }
}
