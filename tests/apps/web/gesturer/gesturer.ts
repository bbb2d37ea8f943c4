/**
 * Does jobs with a Gesturer whose worker is in this process: `node gesturer.mjs MODEL_FOLDER WASM JOBS.json`.
 *
 * A job has the path `sound`, the path `out` for its directions, and `options`. With `piece` it is a stream that hears
 * so many samples at a time, and of the path `other` the other person; `changes` has what changes before a piece. With `abort` it is cancelled after a window.
 * stdout gets what was found, as JSON.
 */

import { readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { Gesturer, type Motion, readSound } from "../../../../integrations/web/src/index.js";
import { logMel } from "../../../../integrations/web/src/sound/mel.js";
import { Host } from "../../../../integrations/web/src/synthesis/host.js";

interface Job {
  sound: string;
  out: string;
  options: object;
  kind?: "mel";
  piece?: number;
  other?: string;
  changes?: Record<number, { cue?: [string, number?]; clear?: [number?] }>;
  abort?: boolean;
}

class InProcessWorker {
  onmessage: ((event: { data: unknown }) => void) | undefined;
  private readonly host = new Host((reply, transfer) => {
    const data = structuredClone(reply, { transfer });
    setTimeout(() => this.onmessage?.({ data }));
  });

  postMessage(data: Parameters<Host["handle"]>[0], transfer: Transferable[] = []): void {
    void this.host.handle(structuredClone(data, { transfer }));
  }

  terminate(): void {}
}

function read(path: string): Float32Array {
  const file = readFileSync(path);
  return readSound(file.buffer.slice(file.byteOffset, file.byteOffset + file.length) as ArrayBuffer);
}

async function run(gesturer: Gesturer, job: Job): Promise<object> {
  const samples = read(job.sound);
  if (job.kind === "mel") {
    writeFileSync(job.out, logMel(samples));
    return {};
  }
  if (job.piece) return stream(gesturer, job, samples);
  const controller = new AbortController();
  const fractions: number[] = [];
  const onprogress = (fraction: number) => {
    fractions.push(fraction);
    if (job.abort) controller.abort();
  };
  const motion: Motion = await gesturer.generate(samples, { ...job.options, onprogress, signal: controller.signal });
  writeFileSync(job.out, motion.directions);
  return { meta: motion.meta, fractions };
}

async function stream(gesturer: Gesturer, job: Job, samples: Float32Array): Promise<object> {
  const live = await gesturer.stream(job.options);
  const other = job.other && read(job.other);
  const calls: Promise<Float32Array>[] = [];
  for (let start = 0; start < samples.length; start += job.piece!) {
    const { cue, clear, ...change } = job.changes?.[calls.length] ?? {};
    live.change(change);
    if (cue) live.cue(...cue);
    if (clear) void live.clear(...clear);
    const [own, others] = [samples, other].map((sound) => sound && sound.subarray(start, start + job.piece!));
    calls.push(live.feed(own as Float32Array, others || undefined));
  }
  const parts = await Promise.all([...calls, live.flush()]);
  live.close();
  writeFileSync(job.out, Buffer.concat(parts.map((part) => Buffer.from(part.buffer))));
  return { latency: live.latency, state: live.state };
}

const [folder, wasm, jobs] = process.argv.slice(2);
const server = createServer((request, response) => {
  const name = request.url!.slice(1);
  const content = name === "ort.wasm.gz" ? gzipSync(readFileSync(wasm), { level: 1 }) : readFileSync(join(folder, name));
  response.setHeader("Content-Length", content.length).end(content);
});
await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
Object.assign(globalThis, { Worker: InProcessWorker });
const origin = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
const loading: number[] = [];
const gesturer = await Gesturer.load(`${origin}/model.onnx`, {
  worker: `${origin}/worker.js`,
  wasm: `${origin}/ort.wasm.gz`,
  onprogress: (fraction) => loading.push(fraction),
});
const found: object[] = [];
for (const job of JSON.parse(readFileSync(jobs, "utf8")) as Job[]) {
  found.push(await run(gesturer, job).catch((error: Error) => ({ error: `${error.name}: ${error.message}` })));
}
console.log(JSON.stringify({ loading, found }));
gesturer.close();
server.closeAllConnections();
server.close();
