/** The controls of style, take, energy and look-ahead. */

import type { Description } from "../src/description.js";
import { HOP, LOOK_AHEAD } from "../src/synthesis/options.js";
import { chooseStyle, type StyleOptions } from "../src/synthesis/style.js";
import { find, show } from "./elements.js";

const PATIENCE = 250; // milliseconds without another change before one is followed

export class Settings {
  private timer: ReturnType<typeof setTimeout> | undefined;
  private fps = 15;

  /**
   * @param onstyle - is called after changes of style or take.
   * @param onenergy - is called at each change of the energy.
   */
  constructor(onstyle: () => void, onenergy: () => void) {
    const changed = () => {
      this.label();
      clearTimeout(this.timer);
      this.timer = setTimeout(onstyle, PATIENCE);
    };
    for (const name of ["#speaker", "#second", "#share", "#seed"]) find(name).addEventListener("input", changed);
    find("#seed").addEventListener("change", () => {
      find<HTMLInputElement>("#seed").value = String(this.seed); // within the takes that there are
    });
    find("#another").addEventListener("click", () => {
      const takes = find<HTMLInputElement>("#seed");
      takes.value = String((this.seed + 1) % (Number(takes.max) + 1));
      changed();
    });
    find("#energy").addEventListener("input", () => {
      this.label();
      onenergy();
    });
    find<HTMLInputElement>("#ahead").value = String(LOOK_AHEAD);
    find("#ahead").addEventListener("input", () => this.label());
    find("#settings").addEventListener("submit", (event) => event.preventDefault());
  }

  /** Offers the speakers and the takes of a model. */
  offer({ speakers, takes, fps }: Description): void {
    for (const name of ["#speaker", "#second"]) {
      find<HTMLSelectElement>(name).append(...Object.keys(speakers).map((speaker) => new Option(speaker)));
    }
    find<HTMLInputElement>("#seed").max = String(takes.length - 1);
    this.fps = fps;
    this.label();
  }

  get seed(): number {
    const { valueAsNumber, max } = find<HTMLInputElement>("#seed");
    return Math.min(Math.max(Math.round(valueAsNumber) || 0, 0), Number(max));
  }

  get energy(): number {
    return find<HTMLInputElement>("#energy").valueAsNumber;
  }

  resetEnergy(): void {
    find<HTMLInputElement>("#energy").value = "1";
    this.label();
  }

  get lookAhead(): number {
    return find<HTMLInputElement>("#ahead").valueAsNumber;
  }

  /** The style of a whole motion; without a speaker it is drawn with the seed. */
  get style(): StyleOptions {
    const [speaker, second] = this.names;
    if (!speaker) return {};
    if (!second || second === speaker) return { speaker };
    return { mixture: { [speaker]: 1 - this.share, [second]: this.share } };
  }

  /** The same style and seed as values, which a stream takes at any time. */
  values(description: Description): number[] {
    return Array.from(chooseStyle(description, this.style, this.seed).values);
  }

  private get names(): [string, string] {
    return [find<HTMLSelectElement>("#speaker").value, find<HTMLSelectElement>("#second").value];
  }

  private get share(): number {
    return find<HTMLInputElement>("#share").valueAsNumber / 100;
  }

  private label(): void {
    const [speaker, second] = this.names;
    show(Boolean(speaker), "#mixes");
    show(Boolean(speaker && second && speaker !== second), "#shares");
    find("[for=share]").textContent = `${Math.round(100 * this.share)} %`;
    find("[for=energy]").textContent = this.energy.toFixed(1);
    const latency = Math.round((1000 * Math.max(this.lookAhead + HOP, 1.5)) / this.fps);
    find("[for=ahead]").textContent = `${latency} ms`;
  }
}
