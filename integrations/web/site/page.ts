/** The page: what it does, and what it shows of that. */

import { Motion } from "../src/motion/motion.js";
import { fileOf, find, press, show } from "./elements.js";
import { Energy } from "./energy.js";
import type { ShownFigure } from "./figure.js";
import { LiveRun, type Source } from "./live.js";
import { Microphone } from "./microphone.js";
import { Model } from "./model.js";
import { progress, say } from "./news.js";
import { Panel } from "./panel.js";
import { peaksOf } from "./peaks.js";
import { Player } from "./player.js";
import { saveMotion, saveVideo } from "./saving.js";
import { Settings } from "./settings.js";
import { openSound, RATE, waveOf, type Sound } from "./sound.js";
import { describe, generate, stemOf, type Take } from "./take.js";
import { Video } from "./video.js";

const HELLO = "Choose a sound file, or drop one here, or speak into the microphone.";
const NO_FIGURE = "This browser cannot draw the figure; gestures can still be generated and saved.";
const FACTS_EVERY = 250; // milliseconds

export class Page {
  readonly settings = new Settings(
    () => this.changeStyle(),
    () => this.changeEnergy(),
  );
  readonly model = new Model(this.settings);
  readonly player = new Player();
  take: Take | null = null;
  /** The motion that is shown: that of the take with the energy of the settings. */
  motion: Motion | null = null;
  run: LiveRun | null = null;
  /** Resolves when the model is there, or cannot be loaded. */
  readonly started: Promise<void>;
  private readonly panel = new Panel((time) => this.seek(time));
  private readonly energy = new Energy(
    (motion) => this.showMotion(motion),
    (motion) => {
      this.motion = motion;
      if (this.run) return;
      this.settings.resetEnergy();
      this.showTake();
      say("The energy of the motion could not be changed; move the slider again.", true);
    },
  );
  private acting: Acting | null = null;
  private job: AbortController | null = null;
  /** The sound that the job generates gestures for; null while it is read. */
  private heard: Sound | null = null;
  private video: Video | null = null;
  private isMuted = false;
  private nextFacts = 0;

  constructor() {
    show(Video.isPossible, '[data-format="webm"]');
    document.addEventListener("visibilitychange", () => {
      if (document.hidden && this.video) void this.stop("No video was saved, because a hidden page is not drawn.", true);
    });
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
    await this.hear(`Reading ${file.name} ...`, async () => file);
  }

  /** Opens the recording of the site. */
  async openExample(): Promise<void> {
    await this.hear("Loading the example ...", async (signal) => {
      const response = await fetch(fileOf("hello.wav"), { signal }).catch(() => null);
      if (!response?.ok) throw new Error("The example cannot be loaded; is the network there?");
      return new File([await response.blob()], "hello.wav");
    });
  }

  /** Shows an avatar in place of the figure. */
  async wear(file: File): Promise<void> {
    if (this.video) return this.keepFigure();
    say(`Opening ${file.name} ...`);
    try {
      await this.model.loaded();
      const { screen } = this.model;
      if (!screen) throw new Error(NO_FIGURE);
      say(`Avatar: ${await screen.wear(file)}`);
    } catch (error) {
      say((error as Error).message, true);
    }
  }

  undress(): void {
    if (this.video) return this.keepFigure();
    this.model.screen?.undress();
    say(this.take ? describe(this.take) : HELLO);
  }

  private keepFigure(): void {
    say("The figure can be changed when the video is saved.", true);
  }

  get hasAvatar(): boolean {
    return Boolean(this.model.screen?.hasAvatar);
  }

  /** Begins to follow the microphone, or another source. */
  async listen(open: () => Promise<Source> = () => Microphone.open()): Promise<void> {
    this.player.pause();
    await this.work("Waiting for the microphone ...", async (signal) => {
      const source = await open();
      try {
        const gesturer = await this.model.loaded();
        const { settings } = this;
        const { description } = gesturer;
        const style = () => ({ values: settings.values(description), energy: settings.energy });
        const stream = await gesturer.stream({ lookAhead: settings.lookAhead, seed: settings.seed, ...style() });
        if (signal.aborted) stream.close();
        signal.throwIfAborted();
        press(find("#rest"), false);
        press(find("#record"), false);
        const onfail = (reason: string) => void this.stop(reason, true);
        this.acting ??= new Acting(find("#acting"), Object.keys(description.cues), (asked) => this.act(asked));
        this.run = new LiveRun(source, stream, this.model.figure as ShownFigure, this.acting, onfail);
        stream.change(style()); // it may have changed meanwhile
      } catch (error) {
        source.close();
        throw error;
      }
      say("Listening: the figure follows what you say.");
    });
  }

  /** Keeps what is said and shown from now on. */
  record(): void {
    if (!this.run || this.run.recording) return;
    this.run.record();
    press(find("#record"), true);
    say("Recording; Stop shows what was recorded.");
  }

  /** Lets the arms rest, or move again. */
  turnRest(): void {
    const isResting = find("#rest").getAttribute("aria-pressed") !== "true";
    press(find("#rest"), isResting);
    this.run?.stream.change({ muted: isResting });
  }

  /** Does what a button beside the speech asks for. */
  private act({ state, cue, clear }: Asked): void {
    if (state) this.run?.stream.change({ state });
    if (cue) this.run?.stream.cue(cue);
    if (clear) this.run?.interrupt();
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
    progress(null);
    say(text, isTrouble);
    this.showState();
    if (!run) return;
    const found = (await run.end())?.result(3 * run.numBones);
    if (this.run) return; // another one has begun
    if (!found || !this.model.gesturer) {
      this.showTake();
      return this.changeEnergy(); // which was that of the run
    }
    const take = this.keep(found.samples, found.directions);
    if (!isTrouble) say(describe(take));
  }

  turnPlay(): void {
    if (!this.take || this.isBusy) return;
    if (this.player.isPlaying) this.player.pause();
    else void this.player.play();
  }

  seek(time: number): void {
    if (!this.take || this.isBusy) return;
    this.player.time = Math.min(Math.max(time, 0), this.take.sound.samples.length / RATE);
    this.model.screen?.refresh();
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
    if (this.energy.isPending) return say("The energy is being changed; save the motion when it is shown.", true);
    if (format === "webm") await this.film(stemOf(take));
    else await saveMotion(motion, stemOf(take), format);
  }

  resetView(): void {
    this.model.screen?.resetView();
  }

  rotate(around: number, up: number): void {
    this.model.screen?.rotate(around, up);
  }

  turnTheme(): void {
    this.model.screen?.turnTheme();
  }

  turnBones(): void {
    this.model.screen?.turnBones();
  }

  /** Loads the model, and says what the page is for. */
  private async start(): Promise<void> {
    this.showState();
    say("Loading the model ...");
    try {
      await this.model.loaded();
      if (!this.model.screen) say(NO_FIGURE, true);
      else if (!this.isBusy && !this.take) say(HELLO);
    } catch (error) {
      say((error as Error).message, true);
    }
  }

  /** Does one thing at a time: a new one ends the one before. */
  private async work(text: string, action: (signal: AbortSignal) => Promise<void>): Promise<void> {
    await this.stop(text);
    this.job?.abort(new Error(text)); // one that came while a run was ended
    const job = new AbortController();
    this.job = job;
    this.heard = null;
    this.showState();
    try {
      await action(job.signal);
    } catch (error) {
      if (this.job === job) say((error as Error).message, true);
    }
    if (this.job !== job) return;
    this.job = null;
    progress(null);
    this.showState();
  }

  /** Generates gestures for the sound of a file. */
  private hear(text: string, fetchFile: (signal: AbortSignal) => Promise<File>): Promise<void> {
    return this.work(text, async (signal) => this.gesture(await openSound(await fetchFile(signal), signal), signal));
  }

  private async gesture(sound: Sound, signal: AbortSignal): Promise<void> {
    const gesturer = await this.model.loaded();
    signal.throwIfAborted();
    this.heard = sound;
    const isSame = sound === this.take?.sound;
    if (!isSame) say(`Generating the gestures of ${sound.name} ...`);
    const take = await generate(gesturer, sound, this.settings, signal, progress);
    signal.throwIfAborted();
    this.take = take;
    if (!isSame) this.present();
    this.changeEnergy();
    say(describe(take));
  }

  /** Makes a take of a recording. */
  private keep(samples: Float32Array<ArrayBuffer>, directions: Float32Array): Take {
    const { skeleton, fps } = this.model.gesturer!.description;
    const sound = { name: "recording.wav", samples, peaks: peaksOf(samples, RATE), content: waveOf(samples) };
    this.settings.resetEnergy(); // it is in the recording
    this.take = { sound, motion: new Motion(skeleton, directions, fps), seconds: null };
    this.present();
    this.changeEnergy();
    this.showState();
    return this.take;
  }

  /** Gives the player and the timeline the sound of the take, and plays it. */
  private present(): void {
    const { sound } = this.take as Take;
    this.player.load(sound.content, () => waveOf(sound.samples));
    this.player.isMuted = this.isMuted;
    this.panel.present(sound);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) void this.player.play();
  }

  private changeStyle(): void {
    const { gesturer } = this.model;
    if (this.run && gesturer) this.run.stream.change({ values: this.settings.values(gesturer.description) });
    if (this.run || this.video) return;
    const isRecording = this.take?.seconds === null;
    if (isRecording && !this.job) return say("The motion of a recording stays; the next one will have this style.");
    const taken = isRecording ? null : this.take?.sound;
    const sound = this.job ? this.heard : taken; // of a file that is still read, the gestures will have the new style
    if (sound) void this.work("Generating another motion ...", (signal) => this.gesture(sound, signal));
  }

  private changeEnergy(): void {
    if (this.run) this.run.stream.change({ energy: this.settings.energy });
    else if (this.take && !this.video) this.energy.ask(this.take.motion, this.settings.energy);
  }

  private showMotion(motion: Motion): void {
    this.motion = motion;
    if (!this.run) this.showTake();
  }

  private showTake(): void {
    if (this.motion) this.model.figure?.present(this.motion);
    else this.model.figure?.clear();
    if (this.motion) this.model.screen?.fit();
    this.model.screen?.refresh();
    this.showState();
  }

  private async film(stem: string): Promise<void> {
    const { screen } = this.model;
    if (!screen) return say(NO_FIGURE, true);
    const begin = (video: Video) => {
      this.video = video;
      this.showState();
      screen.refresh();
    };
    await saveVideo(this.player, screen.canvas, stem, begin, (video) => this.video === video);
    if (!this.video) return; // stopped
    this.video = null;
    progress(null);
    this.showState();
    this.changeEnergy(); // which may have been changed meanwhile
  }

  private get number(): number | null {
    if (this.run) return this.run.number;
    return this.motion ? this.player.time * this.motion.fps : null;
  }

  private tick(now: number): void {
    requestAnimationFrame((now) => this.tick(now));
    const isMoving = this.run ? this.run.number !== null : this.player.isPlaying;
    const hasDrawn = this.model.screen?.draw(this.number, isMoving, now);
    if (hasDrawn) this.video?.draw();
    if (this.take && !this.run && hasDrawn) {
      this.panel.showTime(this.time);
      if (this.video) progress((this.time * RATE) / this.take.sound.samples.length);
    }
    if (now < this.nextFacts) return;
    this.nextFacts = now + FACTS_EVERY;
    this.panel.showPlaying(this.player.isPlaying);
    if (!this.run) return;
    this.panel.showRun(this.run);
    this.acting?.showState(this.run.stream.state);
  }

  private showState(): void {
    this.panel.showState(this.isBusy, Boolean(this.run), Boolean(this.take));
  }
}
