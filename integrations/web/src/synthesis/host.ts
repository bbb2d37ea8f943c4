/** What the worker does: it answers the requests of a page. */

import { generate } from "./generate.js";
import type { Frames, NumberedRequest, Reply } from "./messages.js";
import { Sampler } from "./sampler.js";
import { Stream } from "./stream.js";

interface OpenStream {
  stream: Stream;
  /** Resolves when all calls so far are done. */
  last: Promise<unknown>;
}

/** Answers requests; streams go on while a motion is generated. */
export class Host {
  private sampler: Sampler | undefined;
  private readonly streams = new Map<number, OpenStream>();
  private readonly running = new Set<number>(); // generations that are not cancelled

  /** @param reply - sends an answer, and gives the memory of arrays away. */
  constructor(private readonly reply: (reply: Reply, transfer: Transferable[]) => void) {}

  /** Answers a request; the promise is never rejected. */
  async handle(request: NumberedRequest): Promise<void> {
    try {
      const { result, transfer } = await this.answer(request);
      this.reply({ id: request.id, result }, transfer);
    } catch (error) {
      this.reply({ id: request.id, error: error instanceof Error ? error.message : String(error) }, []);
    }
  }

  private async answer(request: NumberedRequest): Promise<{ result: unknown; transfer: Transferable[] }> {
    const none = { result: null, transfer: [] };
    switch (request.kind) {
      case "load":
        this.sampler = await Sampler.create(request.description, request.model, await unpacked(request.wasm));
        return none;
      case "generate": {
        const { id, samples, options } = request;
        this.running.add(id);
        const pause = (progress: number) => this.pause(id, progress);
        const result = await generate(this.loaded(), samples, options, pause).finally(() => this.running.delete(id));
        return { result, transfer: [result.directions.buffer as ArrayBuffer] };
      }
      case "cancel":
        this.running.delete(request.generation);
        return none;
      case "stream": {
        const stream = new Stream(this.loaded(), request.options);
        this.streams.set(request.id, { stream, last: Promise.resolve() });
        return { result: stream.latency, transfer: [] };
      }
      case "feed":
        return this.frames(request.stream, (stream) => stream.feed(request.samples, request.other));
      case "flush":
        return this.frames(request.stream, (stream) => stream.flush());
      case "change":
        await this.inTurn(request.stream, async (stream) => stream.change(request.change));
        return none;
      case "cue":
        await this.inTurn(request.stream, async (stream) => stream.cue(request.cue, request.at));
        return none;
      case "clear": {
        const result = await this.inTurn(request.stream, async (stream) => stream.clear(request.frame));
        return { result, transfer: [] };
      }
      case "close":
        this.streams.delete(request.stream);
        return none;
    }
  }

  private async frames(id: number, call: (stream: Stream) => Promise<Float32Array>) {
    const result = await this.inTurn(id, async (stream): Promise<Frames> => {
      const directions = await call(stream);
      return { directions, state: stream.state };
    });
    return { result, transfer: [result.directions.buffer as ArrayBuffer] };
  }

  /** Calls a stream after the calls before are done. */
  private inTurn<T>(id: number, call: (stream: Stream) => Promise<T>): Promise<T> {
    const open = this.streams.get(id);
    if (!open) throw new Error("the stream is closed; begin another one with Gesturer.stream");
    const done = open.last.then(() => call(open.stream));
    open.last = done.then(() => undefined, () => undefined); // the caller has the error
    return done;
  }

  /** Tells the progress of a generation, and waits until other requests have been seen. */
  private async pause(id: number, progress: number): Promise<void> {
    this.reply({ id, progress }, []);
    await nextTask();
    if (!this.running.has(id)) throw new Error("the generation was cancelled");
  }

  private loaded(): Sampler {
    if (!this.sampler) throw new Error("no model is loaded");
    return this.sampler;
  }
}

/** Returns bytes that may be compressed by gzip; a server may have unpacked them. */
async function unpacked(bytes: ArrayBuffer): Promise<ArrayBuffer> {
  const [first, second] = new Uint8Array(bytes, 0, Math.min(bytes.byteLength, 2));
  if (first !== 0x1f || second !== 0x8b) return bytes;
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

/** Resolves after messages that have arrived; unlike setTimeout, at once where there are none. */
function nextTask(): Promise<void> {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(null);
  });
}
