/** The page's end of the connection to a worker. */

import type { Reply, Request } from "./messages.js";

interface Pending {
  resolve(result: unknown): void;
  reject(reason: unknown): void;
  onprogress?: ((fraction: number) => void) | undefined;
}

/** A request that is under way. */
export interface Job<T> {
  id: number;
  promise: Promise<T>;
  reject(reason: unknown): void;
}

/** Sends requests to a worker, and resolves them when it answers. */
export class Port {
  private readonly worker: Worker;
  private readonly pending = new Map<number, Pending>();
  private lastId = 0;
  private failure: Error | undefined;

  /** @param url - address of worker.js, on the origin of the page. */
  constructor(url: string | URL) {
    this.worker = new Worker(url, { type: "module" });
    this.worker.onmessage = ({ data }) => this.take(data);
    this.worker.onerror = ({ message }) => {
      this.fail(new Error(`the worker ${url} cannot be run (${message || "it cannot be loaded"})`));
    };
  }

  /** Sends a request, and resolves with its answer. */
  ask<T>(request: Request, transfer: Transferable[] = []): Promise<T> {
    return this.begin<T>(request, transfer).promise;
  }

  /** Sends a request, and returns its number and the promise of its answer. */
  begin<T>(request: Request, transfer: Transferable[] = [], onprogress?: (fraction: number) => void): Job<T> {
    const id = ++this.lastId;
    const { promise, resolve, reject } = withResolvers();
    this.pending.set(id, { resolve, reject, onprogress });
    if (this.failure) this.take({ id, error: this.failure.message });
    else this.worker.postMessage({ ...request, id }, transfer);
    return { id, promise: promise as Promise<T>, reject };
  }

  /** Sends a request whose answer does not matter. */
  send(request: Request): void {
    if (!this.failure) this.worker.postMessage({ ...request, id: ++this.lastId });
  }

  /** Ends the worker, and rejects what it has not answered. */
  close(): void {
    this.fail(new Error("the model is closed; load it again with Gesturer.load"));
  }

  private take(reply: Reply): void {
    const pending = this.pending.get(reply.id);
    if (!pending) return;
    if ("progress" in reply) {
      pending.onprogress?.(reply.progress);
      return;
    }
    this.pending.delete(reply.id);
    if ("error" in reply) pending.reject(new Error(reply.error));
    else pending.resolve(reply.result);
  }

  private fail(reason: Error): void {
    this.worker.terminate();
    this.failure = reason;
    for (const { reject } of this.pending.values()) reject(reason);
    this.pending.clear();
  }
}

function withResolvers() {
  let resolve!: (result: unknown) => void;
  let reject!: (reason: unknown) => void;
  const promise = new Promise<unknown>((onResult, onReason) => {
    [resolve, reject] = [onResult, onReason];
  });
  return { promise, resolve, reject };
}
