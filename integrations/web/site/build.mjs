// Builds the files of the site that do not depend on the model; `ha2g web` adds the others.

import { copyFileSync, existsSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { build } from "esbuild";

/** Name of a script in the site -> source. vrm.js is loaded when an avatar is dropped. */
const SCRIPTS = {
  app: "site/app.ts",
  worker: "src/synthesis/worker.ts",
  reader: "site/reader.ts",
  energy: "site/energy-worker.ts",
  vrm: "site/avatar-view.ts",
};
/** Scripts that browsers run as classic scripts. */
const CLASSIC = { sw: "site/sw.ts", capture: "site/capture.ts" };
const FILES = ["index.html", "style.css", "icon.svg", "manifest.webmanifest"];
// The package onnxruntime-web has no file with its licence.
const COPYRIGHTS = { "onnxruntime-web": "Copyright (c) Microsoft Corporation" };

/**
 * Writes build/site/.
 *
 * @param root - folder of package.json.
 * @param common - options of esbuild.
 * @param writeWasm - writes the WebAssembly of ONNX Runtime to a folder.
 */
export async function buildSite({ root, common, writeWasm }) {
  const folder = join(root, "build/site");
  rmSync(folder, { recursive: true, force: true });
  mkdirSync(folder, { recursive: true });
  const output = { outdir: "build/site", minify: true, metafile: true, legalComments: "none" };
  const options = { ...common, ...output, external: [] };
  const results = await Promise.all([
    build({ ...options, entryPoints: SCRIPTS }),
    build({ ...options, entryPoints: CLASSIC, format: "iife" }),
  ]);
  for (const name of FILES) copyFileSync(join(root, "site", name), join(folder, name));
  writeWasm("build/site");
  const inputs = results.flatMap(({ metafile }) => Object.values(metafile.outputs).flatMap((output) => used(output)));
  writeFileSync(join(folder, "LICENSES.txt"), licenses(root, inputs));
}

/** Returns the sources of which something is in a bundle. */
function used(output) {
  return Object.entries(output.inputs).flatMap(([name, { bytesInOutput }]) => (bytesInOutput ? [name] : []));
}

/** Returns the licences of this package and of all packages that the sources belong to. */
function licenses(root, inputs) {
  const folderOf = (name) => /(?:^|\/)(node_modules\/(?:@[^/]+\/)?[^/]+)\//.exec(name)?.[1];
  const packages = inputs.map(folderOf).filter(Boolean);
  const texts = [...new Set(packages)].sort().map((folder) => license(join(root, folder)));
  const own = `ha2g-web: Apache-2.0\n\n${readFileSync(join(root, "LICENSE"), "utf8")}`;
  return [own, ...texts].join(`\n${"-".repeat(80)}\n\n`);
}

function license(folder) {
  const { name, version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = readdirSync(folder).find((file) => /^licen[cs]e/i.test(file));
  const head = `${name} ${version}: ${license}`;
  if (file && existsSync(join(folder, file))) return `${head}\n\n${readFileSync(join(folder, file), "utf8")}`;
  if (!COPYRIGHTS[name]) throw new Error(`${name} has no file with its licence; add its copyright to site/build.mjs`);
  return `${head}\n\n${COPYRIGHTS[name]}\n\n${MIT}`;
}

const MIT = `Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
`;
