"use strict";
// The page for the sound of a file or the microphone: the frame that is shown is that of the sound that is heard.

const BUFFER = 0.15; // seconds beyond the stated latency
const TOO_SLOW = "The service, or the way to it, is slower than the sound.";
const SPARE = 0.05; // seconds that the delay gets beyond a frame that came late

class SpeakingPage extends LivePage {
  constructor(content) {
    super(content);
    for (const name of ["#settings", "#file", "#microphone"]) find(name).hidden = false;
    find("#tokens").hidden = !content.needsToken;
    find("#style").append(...content.speakers.map((name) => new Option(name)));
    this.isMuted = this.isResting = false;
    this.acting = new Acting(find("#acting"), content.cues, (asked) => this.act(asked));
    this.bind();
    this.stop("Choose a sound file, or drop one here, or speak into the microphone.");
  }

  bind() {
    const on = (selector, event, action) => find(selector).addEventListener(event, action);
    on("#file", "click", () => find("#picker").click());
    on("#picker", "change", () => {
      const [file] = find("#picker").files;
      find("#picker").value = "";
      if (file) this.start(file);
    });
    on("#microphone", "click", () => this.start(null));
    on("#stop", "click", () => this.stop("Stopped."));
    on("#settings", "submit", (event) => event.preventDefault());
    find("#ahead").value = this.content.lookAhead;
    on("#ahead", "input", () => this.label());
    on("#energy", "input", () => { this.label(); this.change({ controls: this.controls }); });
    on("#style", "change", () => { this.label(); this.change({ style: this.style }); });
    on("#seed", "change", () => { if (find("#seed").validity.valid) this.change({ style: this.style }); });
    on("#rest", "click", () => {
      press(find("#rest"), (this.isResting = !this.isResting));
      this.change({ muted: this.isResting });
    });
    on("#mute", "click", () => {
      press(find("#mute"), (this.isMuted = !this.isMuted));
      this.run?.sound?.mute(this.isMuted);
    });
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      if (event.dataTransfer.files.length) this.start(event.dataTransfer.files[0]);
    });
    this.label();
  }

  label() {
    const ahead = Number(find("#ahead").value), { figure, hop } = this.content;
    find("[for=ahead]").textContent = `${ahead} · ${Math.round(1000 * Math.max(ahead + hop, 1.5) / figure.fps)} ms`;
    find("[for=energy]").textContent = Number(find("#energy").value).toFixed(1);
    find("#seeds").hidden = find("#style").value !== "";
  }

  get controls() { return { energy: Number(find("#energy").value) }; }

  get style() {
    const speaker = find("#style").value, seed = find("#seed").value;
    return speaker ? { speaker } : seed ? { seed: Number(seed) } : {};
  }

  change(message) { this.run?.conversation?.send(message); }

  // `file` is null for the microphone. A start that comes before this one is ready takes its place.
  async start(file) {
    this.stop(file ? `Reading ${file.name} ...` : "Waiting for the microphone ...");
    const run = this.run = { file, late: 0, worst: 0 };
    this.acting.showState("auto");
    this.showState();
    try {
      const sound = await Sound.open(file);
      if (this.run !== run) return sound.close();
      run.sound = sound;
      sound.mute(this.isMuted);
      this.say("Connecting ...");
      const asked = {
        rate: sound.rate, look_ahead: Number(find("#ahead").value), style: this.style, controls: this.controls,
        muted: this.isResting, channels: 2,
      };
      const conversation = await Conversation.open(find("#token").value, asked);
      if (this.run !== run) return conversation.close();
      run.conversation = conversation;
      conversation.onframes = (first, rows) => this.take(first, rows);
      conversation.onclose = (reason) => { if (reason) this.stop(`The stream has ended: ${reason}.`, true); };
      this.motion.clear();
      sound.begin(conversation.facts.latency + BUFFER, (pcm) => this.give(pcm));
      this.say(file ? file.name : "Listening: the figure follows what you say.");
      this.showState();
    } catch (error) {
      if (this.run === run) this.stop(error.message, true);
    }
  }

  // What a button asks for; an interruption also ends the sound of a file, where it is that of the figure.
  act(asked) {
    if (!this.run?.conversation) return;
    this.change(asked);
    if (asked.state) this.acting.showState(asked.state);
    if (asked.clear && !this.acting.isOther) this.run.sound.cut();
  }

  // The figure's sound is the left channel, that of the person whom it listens to the right one.
  give(pcm) {
    const { conversation, sound } = this.run;
    if (!pcm) return conversation.send({ end: true });
    const mono = new Int16Array(pcm), both = new Int16Array(2 * mono.length);
    mono.forEach((sample, i) => { both[2 * i + Number(this.acting.isOther)] = sample; });
    conversation.send(both.buffer);
    if (conversation.waiting > 4 * sound.rate * LONGEST_DELAY) return this.stop(TOO_SLOW, true);
    const loudest = new Int16Array(pcm).reduce((most, sample) => Math.max(most, Math.abs(sample)), 0) / 32768;
    find("#level").value = Math.max(Math.sqrt(loudest), 0.8 * find("#level").value);
  }

  // A frame is needed when the one before it is shown. Where it comes later, sound and figure wait, now and from now on.
  take(first, rows) {
    const { sound } = this.run, late = sound.heard - (first - 1) / this.motion.fps;
    this.motion.add(first, rows);
    if (late <= 0) return;
    this.run.late += rows.length;
    if (sound.delay >= LONGEST_DELAY) return this.stop(TOO_SLOW, true);
    sound.setDelay(sound.delay + late + SPARE);
    this.motion.ease();
  }

  // `run` has no conversation until the sound begins.
  get number() {
    const sound = this.run?.conversation && this.run.sound;
    if (!sound) return null;
    if (sound.heard > sound.duration) {
      this.stop("The sound has ended.");
      return null;
    }
    return Math.max(sound.heard, 0) * this.motion.fps;
  }

  stop(text, isTrouble = false) {
    const { sound, conversation } = this.run || {};
    this.run = null;
    sound?.close();
    conversation?.close();
    this.motion.clear();
    this.say(text, isTrouble);
    this.showState();
  }

  showState() {
    const isRunning = Boolean(this.run), wasFocused = document.activeElement?.matches(".main");
    for (const name of ["#file", "#microphone"]) find(name).hidden = isRunning;
    for (const name of ["#stop", "#level", "#time", "#acting"]) find(name).hidden = !isRunning;
    find("#mute").hidden = isRunning && !this.run.file;
    find("#ahead").disabled = find("#token").disabled = isRunning;
    find("#level").value = 0;
    find("#time").textContent = "";
    if (!isRunning) find("#facts").textContent = "";
    if (wasFocused) find(isRunning ? "#stop" : "#file").focus();
  }

  drawn(now, number) {
    const { run, motion } = this;
    if (!run?.conversation || motion.shown === null) return;
    const { sound, conversation } = run, drift = (number - motion.shown) / motion.fps;
    if (!conversation.isClosed && Math.abs(drift) > Math.abs(run.worst)) run.worst = drift;
    if (now < (run.next || 0)) return;
    run.next = now + SHOW_EVERY;
    const whole = Number.isFinite(sound.duration) ? ` / ${clockText(sound.duration)}` : "";
    find("#time").textContent = clockText(Math.max(sound.heard, 0)) + whole;
    const { latency } = conversation.facts, buffer = Math.round(1000 * (sound.delay - latency));
    find("#facts").textContent = `latency ${Math.round(1000 * latency)} + ${buffer} ms · ` +
      `drift ${Math.round(1000 * run.worst)} ms${run.late ? ` · ${run.late} late` : ""} · frame ${Math.floor(motion.shown)}`;
    run.worst = 0;
  }

  // What is heard and shown now, for scripts that check the page.
  shown() {
    const { sound, conversation, late } = this.run || {};
    if (!conversation) return null;
    const { start, delay, context, heard } = sound, { shown, last } = this.motion;
    return { start, delay, heard, shown, last, late, time: context.currentTime, latency: conversation.facts.latency };
  }
}
