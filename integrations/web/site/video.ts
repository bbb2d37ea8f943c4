/** A video of what the page shows, recorded while it plays. */

const KINDS = ["video/webm;codecs=vp9,opus", "video/webm;codecs=vp8,opus", "video/webm"];
const FPS = 30;
const BITS_PER_SECOND = 4_000_000;

export class Video {
  private readonly canvas = document.createElement("canvas");
  private readonly pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private readonly recorder: MediaRecorder;
  private readonly parts: Blob[] = [];

  /** Whether this browser can record. */
  static get isPossible(): boolean {
    return "MediaRecorder" in window && KINDS.some((kind) => MediaRecorder.isTypeSupported(kind));
  }

  /**
   * Begins a recording.
   *
   * @param shown - canvas with the figure; its size is that of the video.
   * @param sound - track of the sound that is played.
   */
  constructor(
    private readonly shown: HTMLCanvasElement,
    sound: MediaStreamTrack,
  ) {
    this.canvas.width = shown.width - (shown.width % 2);
    this.canvas.height = shown.height - (shown.height % 2);
    this.pen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--glow");
    const images = this.canvas.captureStream(FPS).getVideoTracks();
    this.recorder = new MediaRecorder(new MediaStream([...images, sound]), {
      mimeType: KINDS.find((kind) => MediaRecorder.isTypeSupported(kind)),
      videoBitsPerSecond: BITS_PER_SECOND,
    });
    this.recorder.ondataavailable = ({ data }) => this.parts.push(data);
    this.draw();
    this.recorder.start(1000);
  }

  /** Takes what the canvas shows; called right after it was drawn. */
  draw(): void {
    const { width, height } = this.canvas;
    this.pen.fillRect(0, 0, width, height);
    this.pen.drawImage(this.shown, 0, 0, width, height);
  }

  /** Ends the recording, and returns the file. */
  async end(): Promise<Blob> {
    const stopped = new Promise<void>((resolve) => (this.recorder.onstop = () => resolve()));
    this.recorder.stop();
    await stopped;
    return new Blob(this.parts, { type: "video/webm" });
  }
}
