/** The page: what it does, and what it shows of that. */

import { checkDescription } from "../src/description.js";
import { Motion } from "../src/motion/motion.js";
import { Gesturer } from "../src/synthesis/gesturer.js";
import { fileOf, find, press, save, show } from "./elements.js";
import { Energy } from "./energy.js";
import { ShownFigure } from "./figure.js";
import { listen } from "./keys.js";
import { LiveRun, type Source } from "./live.js";
import { Microphone } from "./microphone.js";
import { PEAK_RATE, peaksOf } from "./peaks.js";
import { Player } from "./player.js";
import { Screen } from "./screen.js";
import { Settings } from "./settings.js";
import { openSound, RATE, waveOf, type Sound } from "./sound.js";
import { describe, generate, stemOf, type Take } from "./take.js";
import { Video } from "./video.js";
import { write } from "./writing.js";

const HELLO = "Choose a sound file, or drop one here, or speak into the microphone.";
const NO_FIGURE = "This browser cannot draw the figure; gestures can still be generated and saved.";
const FACTS_EVERY = 250; // milliseconds

export class Page {
  readonly settings = new Settings(
    () => this.changeStyle(),
    () => this.changeEnergy(),
  );
  private readonly energy = new Energy((motion) => {
    this.motion = motion;
    if (!this.run) this.showTake();
  });
  readonly player = new Player();
  gesturer: Gesturer | null = null;
  take: Take | null = null;
  /** The motion that is shown: that of the take with the energy of the settings. */
  motion: Motion | null = null;
  run: LiveRun | null = null;
  private figure: ShownFigure | null = null;
  private screen: Screen | null = null;
  private timeline: Timeline | null = null;
  private loading: Promise<Gesturer> | null = null;
  private job: AbortController | null = null;
  private video: Video | null = null;
  private isMuted = false;
  /** Resolves when the model is there, or cannot be loaded. */
  readonly started: Promise<void>;
  private nextFacts = 0;

  constructor() {
    listen(this);
    show(Video.isPossible, '[data-format="webm"]');
    requestAnimationFrame((now) => this.tick(now));
    this.started = this.start();
  }

  /** Whether something goes on that Stop ends. */
  get isBusy(): boolean {
    return Boolean(this.job || this.run || this.video);
  }

  /** Opens a file that was dropped or chosen: sound, or an avatar. */
  async open(file: File): Promise<void> {
    if (/\.vrm$/i.test(file.name)) return this.wear(file);
    await this.work(`Reading ${file.name} ...`, async (signal) => {
      const sound = await openSound(file, signal);
      await this.gesture(sound, signal);
    });
  }

  /** Opens the recording of the site. */
  async openExample(): Promise<void> {
    const response = await fetch(fileOf("hello.wav")).catch(() => null);
    if (!response?.ok) return this.say("The example cannot be loaded; is the network there?", true);
    await this.open(new File([await response.blob()], "hello.wav"));
  }

  /** Shows an avatar in place of the figure. */
  async wear(file: File): Promise<void> {
    this.say(`Opening ${file.name} ...`);
    try {
      await this.loaded();
      const name = await this.screen?.wear(file);
      this.say(`Avatar: ${name}`);
    } catch (error) {
      this.say((error as Error).message, true);
    }
  }

  undress(): void {
    this.screen?.undress();
    this.say(this.take ? describe(this.take) : HELLO);
  }

  get hasAvatar(): boolean {
    return Boolean(this.screen?.hasAvatar);
  }

  /** Begins to follow the microphone, or another source. */
  async listen(open: () => Promise<Source> = () => Microphone.open()): Promise<void> {
    this.player.pause();
    await this.work("Waiting for the microphone ...", async (signal) => {
      const source = await open();
      try {
        const gesturer = await this.loaded();
        const { settings } = this;
        const { description } = gesturer;
        const style = { values: settings.values(description), energy: settings.energy };
        const stream = await gesturer.stream({ lookAhead: settings.lookAhead, seed: settings.seed, ...style });
        if (signal.aborted) stream.close();
        signal.throwIfAborted();
        press(find("#rest"), false);
        press(find("#record"), false);
        this.run = new LiveRun(source, stream, this.figure as ShownFigure, (reason) => void this.stop(reason, true));
      } catch (error) {
        source.close();
        throw error;
      }
      this.say("Listening: the figure follows what you say.");
    });
  }

  /** Keeps what is said and shown from now on. */
  record(): void {
    if (!this.run || this.run.recording) return;
    this.run.record();
    press(find("#record"), true);
    this.say("Recording; Stop shows what was recorded.");
  }

  /** Lets the arms rest, or move again. */
  turnRest(): void {
    const isResting = find("#rest").getAttribute("aria-pressed") !== "true";
    press(find("#rest"), isResting);
    this.run?.stream.change({ muted: isResting });
  }

  /** Ends what goes on, and says so. */
  async stop(text = "Stopped.", isTrouble = false): Promise<void> {
    const { run, video } = this;
    this.job?.abort(new Error(text));
    this.job = null;
    this.run = null;
    this.video = null;
    if (video) {
      this.player.pause();
      void video.end();
    }
    this.say(text, isTrouble);
    this.showState();
    if (!run) return;
    const found = (await run.end())?.result(3 * run.numBones);
    if (this.run) return; // another one has begun
    if (found && this.gesturer) return this.keep(found.samples, found.directions);
    this.showTake();
  }

  turnPlay(): void {
    if (!this.take || this.isBusy) return;
    if (this.player.isPlaying) this.player.pause();
    else void this.player.play();
  }

  seek(time: number): void {
    if (!this.take || this.isBusy) return;
    this.player.time = Math.min(Math.max(time, 0), this.take.sound.samples.length / RATE);
    this.screen?.refresh();
  }

  get time(): number {
    return this.player.time;
  }

  turnMute(): void {
    this.player.isMuted = this.isMuted = !this.isMuted;
    press(find("#mute"), this.isMuted);
  }

  /** Saves the motion in a format, or a video of it. */
  async saveAs(format: string): Promise<void> {
    find<HTMLDetailsElement>("#save").open = false;
    const { take, motion } = this;
    if (!take || !motion || this.isBusy) return;
    if (format === "webm") return this.film(take);
    const name = `${stemOf(take)}.${format}`;
    this.say(`Writing ${name} ...`);
    await new Promise((resolve) => setTimeout(resolve, 30)); // so that the line is seen
    try {
      save(await write(motion, format), name);
      this.say(`Saved ${name}.`);
    } catch (error) {
      this.say(`${name} cannot be written: ${(error as Error).message}`, true);
    }
  }

  resetView(): void {
    this.screen?.resetView();
  }

  rotate(around: number, up: number): void {
    this.screen?.rotate(around, up);
  }

  turnTheme(): void {
    this.screen?.turnTheme();
  }

  turnBones(): void {
    this.screen?.turnBones();
  }

  /** Says a sentence, or nothing, where readers of the screen hear it. */
  say(text: string, isTrouble = false): void {
    find("#status").textContent = !text || /[.?!]$/.test(text) ? text : `${text}.`;
    find("#status").classList.toggle("trouble", isTrouble);
  }

  /** Loads the model, and says what the page is for. */
  private async start(): Promise<void> {
    this.showState();
    this.say("Loading the model ...");
    try {
      await this.loaded();
      if (!this.screen) this.say(NO_FIGURE, true);
      else if (!this.isBusy && !this.take) this.say(HELLO);
    } catch (error) {
      this.say((error as Error).message, true);
    }
  }

  /** Returns the model, which is loaded again if that has failed before. */
  private loaded(): Promise<Gesturer> {
    this.loading ??= this.load().catch((error: Error) => {
      this.loading = null;
      throw new Error(`The model cannot be loaded: ${error.message}`);
    });
    return this.loading;
  }

  private async load(): Promise<Gesturer> {
    const onprogress = (fraction: number) => this.progress(fraction < 1 ? fraction : null);
    const options = { worker: fileOf("worker.js"), wasm: fileOf("ort.wasm.gz"), onprogress };
    const loading = Gesturer.load(fileOf("model/model.onnx"), options).finally(() => this.progress(null));
    [this.gesturer] = await Promise.all([loading, this.showFigure()]);
    return this.gesturer;
  }

  /** Shows the figure, for which the description of the model is enough. */
  private async showFigure(): Promise<void> {
    if (this.figure) return;
    const response = await fetch(fileOf("model/model.json"));
    if (!response.ok) return; // the model is missing as well, which is said
    const description = checkDescription(await response.json());
    const { skeleton, fps, name, license, speakers } = description;
    this.settings.offer(description);
    find("#model").textContent = `Model ${name}, ${Object.keys(speakers).length} speakers${license ? `, ${license}` : ""}.`;
    this.figure = new ShownFigure(skeleton, fps);
    try {
      this.screen = new Screen(this.figure, skeleton);
    } catch (error) {
      console.warn(`The figure cannot be drawn: ${(error as Error).message}`); // motion can still be made and saved
    }
  }

  /** Does one thing at a time: a new one ends the one before. */
  private async work(text: string, action: (signal: AbortSignal) => Promise<void>): Promise<void> {
    await this.stop(text);
    const job = new AbortController();
    this.job = job;
    this.showState();
    try {
      await action(job.signal);
    } catch (error) {
      if (this.job === job) this.say((error as Error).message, true);
    }
    if (this.job !== job) return;
    this.job = null;
    this.progress(null);
    this.showState();
  }

  private async gesture(sound: Sound, signal: AbortSignal, isSame = false): Promise<void> {
    const gesturer = await this.loaded();
    signal.throwIfAborted();
    if (!isSame) this.say(`Generating the gestures of ${sound.name} ...`);
    const onprogress = (fraction: number) => this.progress(fraction);
    const take = await generate(gesturer, sound, this.settings, signal, onprogress);
    signal.throwIfAborted();
    this.take = take;
    if (!isSame) this.present();
    this.changeEnergy();
    this.say(describe(take));
  }

  /** Makes a take of a recording. */
  private keep(samples: Float32Array<ArrayBuffer>, directions: Float32Array): void {
    const { skeleton, fps } = (this.gesturer as Gesturer).description;
    const sound = { name: "recording.wav", samples, peaks: peaksOf(samples, RATE), content: waveOf(samples) };
    this.settings.resetEnergy(); // it is in the recording
    this.take = { sound, motion: new Motion(skeleton, directions, fps), seconds: null };
    this.present();
    this.changeEnergy();
    this.say(describe(this.take));
    this.showState();
  }

  /** Gives the player and the timeline the sound of the take, and plays it. */
  private present(): void {
    const { sound } = this.take as Take;
    const duration = sound.samples.length / RATE;
    this.player.load(sound.content, () => waveOf(sound.samples));
    this.player.isMuted = this.isMuted;
    find<HTMLInputElement>("#scrub").max = String(duration);
    const canvas = find<HTMLCanvasElement>("#timeline");
    const fresh = canvas.cloneNode() as HTMLCanvasElement; // without the listeners of the timeline before
    canvas.replaceWith(fresh);
    show(true, "#track");
    this.timeline = new Timeline(fresh, { duration, words: [], peakRate: PEAK_RATE }, sound.peaks, (time) => this.seek(time));
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) void this.player.play();
  }

  private changeStyle(): void {
    if (this.run && this.gesturer) this.run.stream.change({ values: this.settings.values(this.gesturer.description) });
    else if (this.take?.seconds != null && !this.video) {
      const { sound } = this.take;
      void this.work("Generating another motion ...", (signal) => this.gesture(sound, signal, true));
    }
  }

  private changeEnergy(): void {
    if (this.run) this.run.stream.change({ energy: this.settings.energy });
    else if (this.take) this.energy.ask(this.take.motion, this.settings.energy);
  }

  private showTake(): void {
    if (this.motion) this.figure?.present(this.motion);
    else this.figure?.clear();
    this.screen?.refresh();
    this.showState();
  }

  private async film(take: Take): Promise<void> {
    if (!this.screen) return;
    this.player.pause();
    this.player.time = 0;
    const track = this.player.track();
    const video = new Video(this.screen.canvas, track);
    this.video = video;
    this.say("Recording the video, which takes as long as the sound ...");
    this.showState();
    this.screen.refresh();
    await this.player.play();
    await this.player.ended();
    if (this.video !== video) return; // stopped
    const content = await video.end();
    this.video = null;
    this.progress(null);
    save(content, `${stemOf(take)}.webm`);
    this.say(`Saved ${stemOf(take)}.webm.`);
    this.showState();
  }

  private get number(): number | null {
    if (this.run) return this.run.number;
    return this.motion ? this.player.time * this.motion.fps : null;
  }

  private tick(now: number): void {
    requestAnimationFrame((now) => this.tick(now));
    const isMoving = this.run ? this.run.number !== null : this.player.isPlaying;
    const hasDrawn = this.screen?.draw(this.number, isMoving, now);
    if (hasDrawn) this.video?.draw();
    if (this.take && !this.run && hasDrawn) this.showTime();
    if (now < this.nextFacts) return;
    this.nextFacts = now + FACTS_EVERY;
    this.showFacts();
  }

  private showTime(): void {
    const { time } = this.player;
    const duration = (this.take as Take).sound.samples.length / RATE;
    this.timeline?.draw(time);
    find("#time").textContent = `${clockText(time)} / ${clockText(duration)}`;
    const scrub = find<HTMLInputElement>("#scrub");
    scrub.value = String(time);
    scrub.setAttribute("aria-valuetext", clockText(time));
    if (this.video) this.progress(time / duration);
  }

  private showFacts(): void {
    const { isPlaying } = this.player;
    find("#play").dataset.state = isPlaying ? "playing" : "paused";
    find("#play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
    if (!this.run) return;
    const { stream, delay, late, level, recording } = this.run;
    find<HTMLMeterElement>("#level").value = level;
    const buffer = Math.round(1000 * (delay - stream.latency));
    const facts = [`latency ${Math.round(1000 * stream.latency)} + ${buffer} ms`];
    if (late) facts.push(`${late} late`);
    if (recording) facts.push(`${clockText(recording.seconds, 0)} recorded`);
    find("#facts").textContent = facts.join(" · ");
  }

  private progress(fraction: number | null): void {
    show(fraction !== null, "#progress");
    find<HTMLProgressElement>("#progress").value = fraction ?? 0;
  }

  private showState(): void {
    const { isBusy } = this;
    const hasTake = Boolean(this.take) && !this.run;
    const wasFocused = document.activeElement?.matches(".main");
    show(!isBusy, "#file", "#microphone", "#example");
    show(isBusy, "#stop");
    show(Boolean(this.run), "#level", "#record", "#rest");
    show(hasTake, "#track", "#time", "#mute");
    show(hasTake && !isBusy, "#play", "#save");
    find("#file").classList.toggle("quiet", hasTake);
    find<HTMLInputElement>("#ahead").disabled = Boolean(this.run);
    if (!this.run) find("#facts").textContent = "";
    if (wasFocused && document.activeElement?.matches("body, [hidden]")) find(isBusy ? "#stop" : "#file").focus();
  }
}
