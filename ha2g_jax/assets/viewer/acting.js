"use strict";
// Buttons for what the figure does beside its speech: states, whose voice is heard, an interruption, and cues.

const VALUES = ["point:left", "point:right", "count:3"]; // that have a button, of the cues with values
const STATES = { auto: "Auto", idle: "Idle", listen: "Listen", think: "Think" };

class Acting {
  // `act` gets what is asked for: { state }, { cue } or { clear: true }.
  constructor(holder, cues, act) {
    this.holder = holder;
    this.act = act;
    const states = this.group("In silence");
    this.states = Object.entries(STATES).map(([state, label]) => this.button(states, label, { state }));
    const voice = this.group("Sound");
    const title = "The sound is that of the person whom the figure listens to (l)";
    this.other = this.button(voice, "Other's voice", {}, { id: "other", title, onclick: () => this.turnOther() });
    this.other.setAttribute("aria-pressed", "false");
    this.button(voice, "Interrupt", { clear: true }, { id: "interrupt", title: "End what the figure says (i)" });
    const row = this.group("Cues");
    const offered = cues.filter((cue) => !cue.includes(":") || VALUES.includes(cue));
    for (const cue of offered) this.button(row, cue[0].toUpperCase() + cue.slice(1).replace(":", " "), { cue });
    this.showState("auto");
  }

  group(label) {
    const group = document.createElement("div"), name = document.createElement("span");
    group.setAttribute("role", "group");
    group.setAttribute("aria-label", (name.textContent = label));
    name.setAttribute("aria-hidden", "true");
    group.append(name);
    this.holder.append(group);
    return group;
  }

  button(group, textContent, asked, more = {}) {
    const onclick = () => this.act(asked);
    const button = Object.assign(document.createElement("button"), { type: "button", textContent, onclick, ...more });
    group.append(button);
    return button;
  }

  turnOther() { this.other.setAttribute("aria-pressed", String(!this.isOther)); }

  // Whether the sound is that of the person whom the figure listens to.
  get isOther() { return this.other.getAttribute("aria-pressed") === "true"; }

  showState(state) {
    Object.keys(STATES).forEach((name, i) => this.states[i].setAttribute("aria-pressed", String(name === state)));
  }
}
