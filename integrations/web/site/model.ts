/** The model of the site, and the figure of its skeleton. */

import { checkDescription } from "../src/description.js";
import { Gesturer } from "../src/synthesis/gesturer.js";
import { fileOf, find } from "./elements.js";
import { ShownFigure } from "./figure.js";
import { progress } from "./news.js";
import { Screen } from "./screen.js";
import type { Settings } from "./settings.js";

export class Model {
  gesturer: Gesturer | null = null;
  figure: ShownFigure | null = null;
  /** What is drawn; null in a browser that cannot draw it. */
  screen: Screen | null = null;
  private loading: Promise<Gesturer> | null = null;

  constructor(private readonly settings: Settings) {}

  /** Returns the model when it is there; it is loaded again if that has failed before. */
  loaded(): Promise<Gesturer> {
    this.loading ??= this.load().catch((error: Error) => {
      this.loading = null;
      throw new Error(`The model cannot be loaded: ${error.message}`);
    });
    return this.loading;
  }

  private async load(): Promise<Gesturer> {
    const onprogress = (fraction: number) => progress(fraction < 1 ? fraction : null);
    const options = { worker: fileOf("worker.js"), wasm: fileOf("ort.wasm.gz"), onprogress };
    const loading = Gesturer.load(fileOf("model/model.onnx"), options).finally(() => progress(null));
    [this.gesturer] = await Promise.all([loading, this.showFigure()]);
    return this.gesturer;
  }

  /** Shows the figure, for which the description of the model is enough. */
  private async showFigure(): Promise<void> {
    if (this.figure) return;
    const responses = await Promise.all(["model/model.json", "model/body.json"].map((name) => fetch(fileOf(name))));
    if (!responses.every(({ ok }) => ok)) return; // the model is missing as well, which is said
    const [facts, body] = await Promise.all(responses.map((response) => response.json()));
    const description = checkDescription(facts);
    const { skeleton, fps, name, license, speakers } = description;
    const parts = [`Model ${name}`, `${Object.keys(speakers).length} speakers`, license].filter(Boolean);
    find("#model").textContent = `${parts.join(", ")}.`;
    this.settings.offer(description);
    this.figure = new ShownFigure(skeleton, fps, body);
    try {
      this.screen = new Screen(this.figure, skeleton);
    } catch (error) {
      console.warn(`The figure cannot be drawn: ${(error as Error).message}`); // motion can still be made and saved
    }
  }
}
