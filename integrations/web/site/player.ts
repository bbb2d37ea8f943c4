/** Playing of sound, whose time is the time of the figure. */

export class Player {
  private readonly audio = new Audio();
  private context: AudioContext | null = null;
  private output: MediaStreamAudioDestinationNode | null = null;
  private speakers: GainNode | null = null;

  constructor() {
    this.audio.preload = "auto";
  }

  /**
   * Takes other sound.
   *
   * @param content - sound that this browser may be able to play.
   * @param instead - makes a WAV file of the same sound, for content that it cannot play.
   */
  load(content: Blob, instead: () => Blob): void {
    this.unload();
    this.audio.onerror = () => {
      this.audio.onerror = null;
      URL.revokeObjectURL(this.audio.src);
      this.audio.src = URL.createObjectURL(instead());
    };
    this.audio.src = URL.createObjectURL(content);
  }

  unload(): void {
    this.audio.pause();
    this.audio.onerror = null;
    if (this.audio.src) URL.revokeObjectURL(this.audio.src);
    this.audio.removeAttribute("src");
    this.audio.load();
  }

  get time(): number {
    return this.audio.currentTime;
  }

  set time(seconds: number) {
    this.audio.currentTime = seconds;
  }

  get isPlaying(): boolean {
    return !this.audio.paused && !this.audio.ended;
  }

  /** Whether the sound has played to its end. */
  get hasEnded(): boolean {
    return this.audio.ended;
  }

  /** Whether the sound is not heard; a recorder gets it all the same. */
  set isMuted(isMuted: boolean) {
    if (this.speakers) this.speakers.gain.value = isMuted ? 0 : 1;
    else this.audio.muted = isMuted;
  }

  /** Plays, from the start if the sound has ended. Returns false if the browser asks for a click first. */
  async play(): Promise<boolean> {
    try {
      await this.audio.play();
      return true;
    } catch (error) {
      if ((error as DOMException).name === "AbortError") return true; // other sound, or a pause, came meanwhile
      return false;
    }
  }

  pause(): void {
    this.audio.pause();
  }

  /** Resolves at the end of the sound, or when it pauses. */
  async ended(): Promise<void> {
    if (!this.isPlaying) return;
    await new Promise((resolve) => {
      this.audio.addEventListener("ended", resolve, { once: true });
      this.audio.addEventListener("pause", resolve, { once: true });
    });
  }

  /** Returns the sound as a track for a recorder, from which it can still be heard. */
  track(): MediaStreamTrack {
    if (!this.context || !this.output) {
      this.context = new AudioContext();
      this.output = new MediaStreamAudioDestinationNode(this.context);
      const source = new MediaElementAudioSourceNode(this.context, { mediaElement: this.audio });
      this.speakers = new GainNode(this.context, { gain: this.audio.muted ? 0 : 1 });
      this.audio.muted = false;
      source.connect(this.output);
      source.connect(this.speakers).connect(this.context.destination);
    }
    void this.context.resume();
    return this.output.stream.getAudioTracks()[0];
  }
}
