/** A model that runs in a worker. */

import { checkDescription, type Description } from "../description.js";
import { Motion } from "../motion/motion.js";
import { checkArray } from "../sound/speech.js";
import { fetchAll } from "./fetching.js";
import { LiveStream } from "./live-stream.js";
import { checkNames, checkObject, type Generated, type Generation, type StreamOptions } from "./options.js";
import { Port } from "./port.js";

export type { LiveStream, StreamOptions };

export interface LoadOptions {
  /** URL of worker.js, on the origin of the page; by default beside the module. */
  worker?: string | URL;
  /** URL of ort.wasm.gz; by default beside the module. */
  wasm?: string | URL;
  /** Called with the fraction of the bytes that have arrived, 0 to 1. */
  onprogress?: (fraction: number) => void;
}

export interface GenerateOptions extends Generation {
  /** Called with the fraction of the windows that are generated, 0 to 1. */
  onprogress?: (fraction: number) => void;
  /** Ends the generation; the promise is then rejected with the reason of the signal. */
  signal?: AbortSignal;
}

/** A model that turns speech into gestures; it computes in a worker, so that the page stays responsive. */
export class Gesturer {
  private constructor(
    /** The model without its networks. */
    readonly description: Description,
    private readonly port: Port,
  ) {}

  /**
   * Loads a model.
   *
   * @param model - URL of model.onnx; its description is model.json beside it.
   * @throws Error if a file cannot be fetched or used, or the worker cannot be started.
   */
  static async load(model: string | URL, options: LoadOptions = {}): Promise<Gesturer> {
    checkNames(options, "load");
    if (typeof Worker === "undefined") throw new Error("a Gesturer needs a browser; there is no Worker here");
    const address = new URL(model, globalThis.location?.href);
    // Bundlers copy the files that these two expressions name.
    const runtime = options.wasm ?? new URL("./ort.wasm.gz", import.meta.url);
    const worker = options.worker ?? new URL("./worker.js", import.meta.url);
    const urls = [new URL("model.json", address), address, new URL(runtime, globalThis.location?.href)];
    const [json, bytes, wasm] = await fetchAll(urls, options.onprogress ?? (() => {}));
    const description = checkDescription(parsed(json));
    const isOwn = hasText(new Uint8Array(bytes), description.hash);
    const port = new Port(worker);
    try {
      await port.ask({ kind: "load", description, model: new Uint8Array(bytes), wasm }, [bytes, wasm]);
      if (!isOwn) throw new Error("model.json is that of another model; write both again with ha2g model onnx --page");
    } catch (error) {
      port.close();
      throw error;
    }
    return new Gesturer(description, port);
  }

  /**
   * Generates gestures for speech; the same arguments give the same motion as `OnnxModel.generate` of Python.
   *
   * @param samples - mono samples at 16 kHz, at least 0.2 s.
   * @returns Motion of round(duration x fps) frames.
   * @throws Error if the speech or an option cannot be used.
   */
  async generate(samples: Float32Array, options: GenerateOptions = {}): Promise<Motion> {
    checkObject(options);
    const { onprogress, signal, ...generation } = options;
    signal?.throwIfAborted();
    checkArray(samples);
    const request = { kind: "generate" as const, samples: samples.slice(), options: generation };
    const job = this.port.begin<Generated>(request, [], onprogress);
    const cancel = () => {
      this.port.send({ kind: "cancel", generation: job.id });
      job.reject(signal!.reason);
    };
    signal?.addEventListener("abort", cancel, { once: true });
    try {
      const { directions, meta } = await job.promise;
      return new Motion(this.description.skeleton, directions, this.description.fps, meta);
    } finally {
      signal?.removeEventListener("abort", cancel);
    }
  }

  /**
   * Begins a motion that follows speech; several may go on at the same time.
   *
   * @throws Error if an option cannot be used.
   */
  async stream(options: StreamOptions = {}): Promise<LiveStream> {
    const { id, promise } = this.port.begin<number>({ kind: "stream", options });
    const latency = await promise;
    const { seed = 0, state = "auto" } = options;
    return new LiveStream(this.port, id, latency, this.description, seed, state);
  }

  /** Ends the worker; what is asked and not answered is rejected. */
  close(): void {
    this.port.close();
  }
}

/** Returns whether bytes have a text; that of the metadata of an ONNX file is behind its weights. */
function hasText(bytes: Uint8Array, text: string): boolean {
  const wanted = new TextEncoder().encode(text);
  for (let at = bytes.lastIndexOf(wanted[0]); at >= 0; at = at ? bytes.lastIndexOf(wanted[0], at - 1) : -1) {
    if (wanted.every((byte, index) => bytes[at + index] === byte)) return true;
  }
  return false;
}

function parsed(json: ArrayBuffer): unknown {
  try {
    return JSON.parse(new TextDecoder().decode(json));
  } catch {
    throw new Error("model.json is not JSON; write it again with ha2g web");
  }
}
