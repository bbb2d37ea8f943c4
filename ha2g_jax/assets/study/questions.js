// The page of an item, as a plugin of jsPsych: its clip or clips, the question, and the keys.

import { element, show } from "./elements.js";
import { Player } from "./player.js";
import { CHECK, ENDS, KEYS, PAIRS, SCALES } from "./texts.js";

const CAPTIONS = ["Left", "Right"];
const ARROWS = { ArrowLeft: "left", ArrowRight: "right", ArrowDown: "equal", ArrowUp: "equal" };

export class QuestionPlugin {
  static info = {
    name: "ha2g-question",
    version: "1",
    parameters: {
      item: { type: jsPsychModule.ParameterType.OBJECT },
      names: { type: jsPsychModule.ParameterType.COMPLEX }, // ids of the stimuli from left to right
      content: { type: jsPsychModule.ParameterType.OBJECT },
      number: { type: jsPsychModule.ParameterType.INT }, // of the item in the session
    },
    data: { answer: { type: jsPsychModule.ParameterType.OBJECT } },
  };

  constructor(jsPsych) { this.jsPsych = jsPsych; }

  trial(display, { item, names, content, number }) {
    Object.assign(this, { item, names, content, begun: performance.now() });
    const isPair = names.length === 2;
    this.player = new Player(names, isPair ? CAPTIONS : [], () => this.status());
    this.groups = isPair ? [this.sides()] : this.scales();
    this.message = element("p", { role: "status", class: "status" });
    const next = element("button", { type: "submit", class: "next" }, "Next");
    const form = element("form", { onsubmit: (event) => { event.preventDefault(); this.finish(); }, onchange: () => this.status() },
      ...this.groups.map(({ box }) => box), element("div", { class: "actions" }, next, this.message));
    show(display, isPair ? `Question ${number}: two clips` : `Question ${number}: one clip`, element("div", { class: `question of-${names.length}` }, this.player.element, form), keys(item.kind));
    this.onkey = (event) => this.press(event);
    document.addEventListener("keydown", this.onkey);
    this.status();
  }

  scales() {
    if (this.item.kind === "attention") return [this.numbers("number", CHECK, [])];
    return this.content.scales.map((name) => this.numbers(name, SCALES[name], ENDS));
  }

  numbers(name, text, ends) {
    const [least, greatest] = this.content.points, values = [];
    for (let value = least; value <= greatest; value += 1) values.push(value);
    const meanings = ends.map((end, index) => `${[least, greatest][index]}: ${end}`);
    return group(name, text, values.map((value) => [String(value), String(value)]), meanings);
  }

  sides() {
    const { question, equal } = PAIRS[this.item.kind];
    return group("choice", { name: "Your choice", question }, [["left", "Left"], ["equal", equal], ["right", "Right"]], []);
  }

  press(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const onButton = event.target instanceof HTMLButtonElement || event.target instanceof HTMLTextAreaElement;
    if (event.key === " " && !onButton) this.player.toggle();
    else if (event.key === "Enter" && !onButton) this.finish();
    else if (this.names.length === 2 && ARROWS[event.key]) choose(this.groups[0], ARROWS[event.key]);
    else if (this.names.length === 1 && /^\d$/.test(event.key)) this.rate(event.key);
    else return;
    event.preventDefault();
    this.status();
  }

  // Chooses a number on the scale with the focus, or else on the first without one, and goes to the next without one.
  rate(value) {
    const focused = this.groups.find(({ box }) => box.contains(document.activeElement));
    const group = focused ?? this.groups.find((each) => !chosen(each)) ?? this.groups[0];
    if (!choose(group, value)) return;
    this.groups.find((each) => !chosen(each))?.inputs[0].focus();
  }

  // Says what is missing, or nothing.
  missing() {
    if (!this.player.hasEnded) return "Play the clip to its end first.";
    const open = this.groups.find((group) => !chosen(group));
    return open ? `Please answer: ${open.name}.` : "";
  }

  status() { if (!this.missing()) this.message.textContent = ""; }

  finish() {
    this.message.textContent = this.missing();
    if (this.message.textContent) return;
    document.removeEventListener("keydown", this.onkey);
    this.player.dispose();
    const seconds = Math.round(performance.now() - this.begun) / 1000;
    const values = Object.fromEntries(this.groups.map((group) => [group.id, chosen(group).value]));
    const { id, kind } = this.item, about = { item: id, kind }, effort = { seconds, plays: this.player.plays };
    const [first, second] = this.names;
    const ratings = () => Object.fromEntries(Object.entries(values).map(([name, value]) => [name, Number(value)]));
    const said = second ? { left: first, right: second, choice: values.choice }
      : kind === "attention" ? { stimulus: first, answer: Number(values.number) } : { stimulus: first, ratings: ratings() };
    this.jsPsych.finishTrial({ answer: { ...about, ...said, ...effort } });
  }
}

// A set of radio buttons with labels [value, text], and texts below its two ends.
function group(id, { name, question }, labels, ends) {
  const inputs = labels.map(([value]) => element("input", { type: "radio", name: id, value, id: `${id}-${value}` }));
  const options = labels.map(([value, text], index) => element("label", { for: `${id}-${value}` }, inputs[index], text));
  const legend = element("legend", {}, element("strong", {}, name), ` ${question}`);
  const below = ends.length ? [element("p", { class: "ends", id: `${id}-ends` }, ...ends.map((end) => element("span", {}, end)))] : [];
  const box = element("fieldset", { "aria-describedby": below[0]?.id ?? null },
    legend, element("div", { class: "options" }, ...options), ...below);
  return { id, name, box, inputs };
}

const chosen = ({ inputs }) => inputs.find(({ checked }) => checked);

function choose({ inputs }, value) {
  const input = inputs.find((each) => each.value === value);
  if (input) {
    input.checked = true;
    input.focus();
  }
  return input;
}

function keys(kind) {
  const rows = KEYS[kind] ?? KEYS.rating;
  const parts = rows.map(([key, meaning]) => element("span", {}, element("kbd", {}, key), ` ${meaning}`));
  return element("p", { class: "keys" }, "Keys: ", ...parts);
}
