// Builds the package: `node build.mjs [target ...]`, all targets without an argument.

import { execFileSync } from "node:child_process";
import { mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";
import { buildSite } from "./site/build.mjs";

const root = dirname(fileURLToPath(import.meta.url));
const require = createRequire(import.meta.url);

/** Options of esbuild that all targets have. */
const common = {
  absWorkingDir: root,
  bundle: true,
  format: "esm",
  target: "es2022",
  charset: "utf8",
  legalComments: "linked",
  external: ["three", "three/*", "@pixiv/three-vrm"],
  logLevel: "warning",
};

/** Entry points of the package: name of the file in dist/ -> source. */
const entries = {
  index: "src/index.ts",
  vrm: "src/adapters/vrm.ts",
  worker: "src/synthesis/worker.ts",
};

const targets = {
  /** dist/: the entries, their types, and the WebAssembly of ONNX Runtime. */
  async package() {
    await build({ ...common, entryPoints: entries, outdir: "dist", minify: true, sourcemap: true });
    execFileSync(process.execPath, [require.resolve("typescript/bin/tsc"), "-p", "tsconfig.types.json"], {
      cwd: root,
      stdio: "inherit",
    });
    writeWasm("dist");
  },

  /** build/test/: the tests, for `node --test`. */
  async tests() {
    rmSync(join(root, "build/test"), { recursive: true, force: true });
    await build({
      ...common,
      entryPoints: readdirSync(join(root, "test"))
        .filter((name) => name.endsWith(".ts"))
        .map((name) => `test/${name}`),
      outdir: "build/test",
      outExtension: { ".js": ".mjs" },
      external: [...common.external, "node:*"],
      sourcemap: "inline",
    });
  },

  /** build/site/: the files of the site that do not depend on the model. */
  async site() {
    await buildSite({ root, common, writeWasm });
  },
};

/**
 * Writes the WebAssembly of ONNX Runtime (CPU only) to a folder as ort.wasm.gz. It is stored compressed, a quarter of
 * the size, because not every static host compresses WebAssembly; the worker unpacks it.
 */
function writeWasm(folder) {
  const source = require.resolve("onnxruntime-web/ort-wasm-simd-threaded.wasm");
  mkdirSync(join(root, folder), { recursive: true });
  writeFileSync(join(root, folder, "ort.wasm.gz"), gzipSync(readFileSync(source), { level: 9 }));
}

const names = process.argv.slice(2);
for (const name of names.length ? names : Object.keys(targets)) {
  if (!targets[name]) throw new Error(`no target ${name}; expected ${Object.keys(targets).join(", ")}`);
  await targets[name]();
}
