// The session of a participant: the order of the items, and the answers, which outlast a reload of the page.

const ID = /^[A-Za-z0-9_-]{1,64}$/;
const NUMBERED = /^[A-Za-z_-]*(\d{1,9})$/;
const CHECK = "attention";

// The participant that the address names, or else one drawn for this browser. Throws for a name that cannot be used.
export function identify(study, storage, address = new URL(location.href)) {
  const given = address.searchParams.get("participant") ?? address.searchParams.get("PROLIFIC_PID");
  if (given !== null) {
    if (!ID.test(given)) throw new Error("The participant code in the link is not valid. Please ask for a new link.");
    return given;
  }
  const key = `ha2g-study/${study}`;
  let drawn = storage.get(key);
  if (!ID.test(drawn ?? "")) {
    const bytes = crypto.getRandomValues(new Uint8Array(8));
    drawn = `anonymous-${Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("")}`;
    storage.set(key, drawn);
  }
  return drawn;
}

// The storage of the browser; where it is not allowed, the memory of the page, which a reload empties.
export class Storage {
  constructor() {
    this.memory = new Map();
    try {
      localStorage.setItem("ha2g-study", "");
      localStorage.removeItem("ha2g-study");
      this.isKept = true;
    } catch {
      this.isKept = false; // the first page tells the participant
    }
  }
  get(key) { return this.isKept ? localStorage.getItem(key) : this.memory.get(key) ?? null; }
  set(key, value) { this.isKept ? localStorage.setItem(key, value) : this.memory.set(key, value); }
  remove(key) { this.isKept ? localStorage.removeItem(key) : this.memory.delete(key); }
}

// The items of a participant in order, and the left and right stimulus of each pair: functions of the participant.
// Participants with numbers take the lists in turn; the list of others is drawn.
export function arrange(content, participant, randomization) {
  randomization.setSeed(`${content.study}:${participant}`);
  const drawn = Math.floor(Math.random() * content.lists.length), numbered = NUMBERED.exec(participant);
  const list = new Set(content.lists[numbered ? Number(numbered[1]) % content.lists.length : drawn]);
  const items = content.items.filter(({ id }) => list.has(id));
  const kinds = randomization.shuffle([...new Set(items.map(({ kind }) => kind))].filter((kind) => kind !== CHECK));
  const blocks = kinds.map((kind) => randomization.shuffle(items.filter((item) => item.kind === kind)));
  const sides = new Map();
  for (const block of blocks) {
    // Half of the pairs of a block are exchanged; of an odd number one more or one less, by chance.
    const start = Math.random() < 0.5 ? 0 : 1;
    const exchanged = randomization.shuffle(block.map((_, index) => index % 2 === start));
    block.forEach(({ id, pair }, index) => {
      if (pair) sides.set(id, exchanged[index] ? [pair[1], pair[0]] : [pair[0], pair[1]]);
    });
  }
  return { order: withChecks(blocks.flat(), items, randomization), sides };
}

// Puts the checks among the other items, about evenly and never first.
function withChecks(order, items, randomization) {
  const checks = randomization.shuffle(items.filter(({ kind }) => kind === CHECK));
  const gap = order.length / (checks.length + 1);
  checks.forEach((check, index) => {
    const place = Math.round((index + 1 + (Math.random() - 0.5) / 2) * gap) + index;
    order.splice(Math.max(1, place), 0, check);
  });
  return order;
}

export class Session {
  constructor(content, participant, storage, randomization) {
    Object.assign(this, { content, participant, storage, key: `ha2g-study/${content.study}/${participant}` });
    Object.assign(this, arrange(content, participant, randomization));
    this.state = this.read() ?? { consent: false, started: null, finished: null, answers: [], comments: "", isSent: false };
  }

  // The stored state, or null if there is none that belongs to these items.
  read() {
    const text = this.storage.get(this.key);
    if (text === null) return null;
    const known = new Set(this.order.map(({ id }) => id));
    const state = JSON.parse(text);
    return Array.isArray(state.answers) && state.answers.every(({ item }) => known.has(item)) ? state : null;
  }

  change(values) {
    Object.assign(this.state, values);
    this.storage.set(this.key, JSON.stringify(this.state));
  }

  record(answer) {
    if (this.state.answers.some(({ item }) => item === answer.item)) return;
    this.change({ answers: [...this.state.answers, answer] });
  }

  get remaining() {
    const answered = new Set(this.state.answers.map(({ item }) => item));
    return this.order.filter(({ id }) => !answered.has(id));
  }

  // The file of answers.
  document() {
    const { consent, started, finished, answers, comments } = this.state;
    return {
      format: "ha2g-study-answers", version: 1, study: this.content.study, participant: this.participant,
      started, finished, consent, order: this.order.map(({ id }) => id), answers, comments,
      client: { user_agent: navigator.userAgent, language: navigator.language },
    };
  }

  forget() {
    this.storage.remove(this.key);
    this.storage.remove(`ha2g-study/${this.content.study}`);
  }
}
