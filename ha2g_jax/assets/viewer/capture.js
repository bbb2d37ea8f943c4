"use strict";
// The sound of a file or of the microphone: it is taken as PCM, and that of a file is played some time later. Both ways
// begin at one sample of one clock, that of the audio context, so that they cannot drift apart.

const PIECE = 0.04; // seconds of sound in a message
const LONGEST_DELAY = 10; // seconds
const MAX_BYTES = 512 * 2 ** 20; // of a file

// Runs in the thread of the audio: sends the samples from number `start` on, `size` at a time, as 16 bits.
function captureProcessor() {
  registerProcessor("capture", class extends AudioWorkletProcessor {
    constructor({ processorOptions }) {
      super();
      Object.assign(this, processorOptions, { pcm: new Int16Array(processorOptions.size), count: 0 });
    }
    process([channels]) {
      for (let i = Math.max(this.start - currentFrame, 0); i < 128; i++) {
        let sample = 0;
        for (const channel of channels) sample += channel[i] / channels.length;
        this.pcm[this.count++] = Math.max(-32768, Math.min(32767, Math.round(32768 * sample)));
        if (this.count < this.size) continue;
        this.port.postMessage(this.pcm.buffer, [this.pcm.buffer]);
        this.pcm = new Int16Array(this.size);
        this.count = 0;
      }
      return true;
    }
  });
}

class Sound {
  // `file` is null for the microphone. Throws an error with a message for people.
  static async open(file) {
    if (!window.AudioWorkletNode || !navigator.mediaDevices) {
      throw new Error("Browsers give sound to pages of https:// and of this computer (localhost) only.");
    }
    const sound = new Sound();
    try {
      await sound.prepare(file);
    } catch (error) {
      sound.close();
      throw error;
    }
    return sound;
  }

  async prepare(file) {
    const context = this.context = new AudioContext({ latencyHint: "interactive" });
    const resumed = context.resume(); // at once, as browsers allow it after a click only
    const module = URL.createObjectURL(new Blob([`(${captureProcessor})()`], { type: "text/javascript" }));
    await context.audioWorklet.addModule(module);
    URL.revokeObjectURL(module);
    this.rate = context.sampleRate;
    this.isMuted = false;
    if (file) {
      if (file.size > MAX_BYTES) throw new Error(`${file.name} is larger than ${MAX_BYTES / 2 ** 20} MiB.`);
      const content = await file.arrayBuffer();
      const buffer = await context.decodeAudioData(content).catch(() => {
        throw new Error(`This browser finds no sound in ${file.name}.`);
      });
      this.source = new AudioBufferSourceNode(context, { buffer });
      this.numSamples = buffer.length;
    } else {
      const audio = { channelCount: 1, echoCancellation: false };
      this.stream = await navigator.mediaDevices.getUserMedia({ audio }).catch((error) => {
        throw new Error({
          NotAllowedError: "The microphone may not be used; allow it for this page in the browser.",
          NotFoundError: "There is no microphone.",
        }[error.name] || `The microphone cannot be used: ${error.message}`);
      });
      this.source = new MediaStreamAudioSourceNode(context, { mediaStream: this.stream });
      this.numSamples = Infinity;
    }
    await resumed;
  }

  get duration() { return this.numSamples / this.rate; }

  // Take the sound from now on; `take` gets pieces of PCM, and null after the last one.
  begin(delay, take) {
    const { context } = this, size = Math.round(PIECE * this.rate), start = Math.ceil((context.currentTime + 0.1) * this.rate);
    this.start = start / this.rate;
    this.capture = new AudioWorkletNode(context, "capture", { processorOptions: { start, size } });
    let left = this.numSamples;
    this.capture.port.onmessage = ({ data }) => {
      if (left <= 0) return;
      take(left < size ? data.slice(0, 2 * left) : data);
      left -= size;
      if (left <= 0) take(null);
    };
    this.line = new DelayNode(context, { maxDelayTime: LONGEST_DELAY });
    this.fade = new GainNode(context);
    this.volume = new GainNode(context, { gain: this.isMuted ? 0 : 1 });
    this.source.connect(this.capture).connect(context.destination); // its output is silent
    if (this.source.start) {
      this.source.connect(this.line).connect(this.fade).connect(this.volume).connect(context.destination);
      this.source.start(this.start);
    }
    this.setDelay(delay);
  }

  // Play the sound later than it is taken, by these seconds.
  setDelay(seconds) {
    const now = this.context.currentTime;
    this.delay = Math.min(seconds, LONGEST_DELAY);
    this.line.delayTime.setValueAtTime(this.delay, now);
    this.fade.gain.setValueAtTime(0, now).linearRampToValueAtTime(1, now + 0.05);
  }

  // End the sound of a file; what is still to be played of it is not heard.
  cut() {
    if (!this.source.start) return;
    this.source.stop();
    this.volume.disconnect();
  }

  mute(isMuted) {
    this.isMuted = isMuted;
    if (this.volume) this.volume.gain.value = isMuted ? 0 : 1;
  }

  // Time of the context whose sound leaves the loudspeaker now.
  get outputTime() {
    const { currentTime, outputLatency = 0 } = this.context, stamp = this.context.getOutputTimestamp();
    if (!stamp.contextTime) return currentTime - outputLatency;
    return Math.min(stamp.contextTime + (performance.now() - stamp.performanceTime) / 1000, currentTime);
  }

  // Moment of the sound that is heard now, in seconds; of the microphone, what was said the delay ago.
  get heard() { return this.outputTime - this.start - this.delay; }

  close() {
    for (const track of this.stream ? this.stream.getTracks() : []) track.stop();
    if (this.capture) this.capture.port.onmessage = null;
    if (this.context) this.context.close();
  }
}
