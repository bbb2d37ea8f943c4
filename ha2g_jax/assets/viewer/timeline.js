"use strict";
// Below the figures: the whole length, and the seconds around the current time with waveform and words.

const SPAN = 10; // seconds in the lower strip

class Timeline {
  constructor(canvas, content, peaks, seek, curves = []) {
    Object.assign(this, { canvas, peaks, seek, curves });
    this.duration = content.duration;
    this.words = content.words;
    this.peakRate = content.peakRate;
    this.isShort = this.duration <= SPAN * 1.5;
    this.span = this.isShort ? this.duration : SPAN;
    this.time = 0;
    new ResizeObserver(() => this.draw(this.time)).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.drag(event, true);
    });
    canvas.addEventListener("pointermove", (event) => { if (event.buttons) this.drag(event, false); });
  }

  // Pressing in the upper strip seeks in the whole length; the lower strip is dragged with the pointer.
  drag(event, isStart) {
    const box = this.canvas.getBoundingClientRect(), fraction = (event.clientX - box.left) / box.width;
    if (isStart) {
      this.isWhole = this.isShort || event.clientY - box.top < this.overview();
      this.from = { fraction, time: this.time };
    }
    if (this.isWhole) this.seek(fraction * this.duration);
    else if (isStart) this.seek(this.first() + fraction * this.span);
    else this.seek(this.time - (event.movementX / box.width) * this.span);
  }

  overview() {
    return this.isShort ? 0 : 22;
  }

  first() {
    return this.isShort ? 0 : Math.min(Math.max(this.time - this.span / 2, 0), this.duration - this.span);
  }

  draw(time) {
    this.time = time;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width) return;
    const ratio = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
    const pen = this.canvas.getContext("2d"), style = getComputedStyle(this.canvas);
    const names = ["ink", "quiet", "wave", "played", "accent", "chip"];
    this.colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`)]));
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const top = this.overview(), first = this.first(), wordLine = this.words.length ? 26 : 0;
    if (top) {
      this.wave(pen, 0, this.duration, width, 0, top - 6, time);
      pen.fillStyle = this.colours.accent;
      pen.fillRect((time / this.duration) * width - 1, 0, 2, top - 4);
      pen.strokeStyle = this.colours.quiet;
      const scale = width / this.duration;
      pen.strokeRect(first * scale + 0.5, 0.5, Math.max(this.span * scale, 3), top - 6);
    }
    this.ticks(pen, first, width, height);
    this.wave(pen, first, this.span, width, top + 2, height - wordLine - 18, time);
    this.speeds(pen, first, width, top + 2, height - wordLine - 18);
    this.chips(pen, first, width, height - wordLine - 14, time);
    pen.fillStyle = this.colours.accent;
    pen.fillRect(((time - first) / this.span) * width - 1, top, 2, height - top - 14);
  }

  wave(pen, first, span, width, top, bottom, time) {
    const middle = (top + bottom) / 2, half = (bottom - top) / 2, step = 3;
    for (let x = 0; x < width; x += step) {
      const start = first + (x / width) * span, end = first + ((x + step) / width) * span;
      const from = Math.floor(start * this.peakRate), to = Math.max(Math.ceil(end * this.peakRate), from + 1);
      let loud = 0;
      for (let i = from; i < Math.min(to, this.peaks.length); i++) loud = Math.max(loud, this.peaks[i]);
      const high = Math.max(0.6, half * (loud / 255));
      pen.fillStyle = start < time ? this.colours.played : this.colours.wave;
      pen.fillRect(x, middle - high, step - 1, 2 * high);
    }
  }

  // The speed of the hands of each figure, in the colour of its shirt.
  speeds(pen, first, width, top, bottom) {
    const most = this.curves.reduce((most, { speeds }) => speeds.reduce((a, b) => Math.max(a, b), most), 0.1);
    for (const { fps, colour, speeds } of this.curves) {
      pen.strokeStyle = colour;
      pen.lineWidth = 1.5;
      pen.beginPath();
      const last = Math.min(Math.ceil((first + this.span) * fps), speeds.length - 1);
      for (let frame = Math.floor(first * fps); frame <= last; frame++) {
        pen.lineTo(((frame / fps - first) / this.span) * width, bottom - (bottom - top) * (speeds[frame] / most));
      }
      pen.stroke();
    }
  }

  ticks(pen, first, width, height) {
    const every = [0.5, 1, 2, 5].find((seconds) => (seconds / this.span) * width > 52) || 10;
    pen.font = "11px system-ui, sans-serif";
    pen.textAlign = "center";
    for (let tick = Math.ceil(first / every) * every; tick <= first + this.span; tick += every) {
      const x = ((tick - first) / this.span) * width;
      pen.fillStyle = this.colours.quiet;
      if (x > 14 && x < width - 14) pen.fillText(clockText(tick, every < 1 ? 1 : 0), x, height - 2);
    }
  }

  chips(pen, first, width, top, time) {
    pen.font = "13px system-ui, sans-serif";
    pen.textAlign = "center";
    let from = 0, to = this.words.length;
    while (from < to) { // the first word that ends in the strip
      const middle = (from + to) >> 1;
      if (this.words[middle][2] < first) from = middle + 1; else to = middle;
    }
    for (let i = from; i < this.words.length && this.words[i][1] < first + this.span; i++) {
      const [text, start, end] = this.words[i];
      const x = ((start - first) / this.span) * width, wide = Math.max(((end - start) / this.span) * width - 2, 2);
      const isNow = time >= start && time < end;
      pen.fillStyle = isNow ? this.colours.accent : this.colours.chip;
      pen.beginPath();
      pen.rect(x, top - 1, wide, 20);
      pen.fill();
      pen.save();
      pen.clip();
      pen.fillStyle = isNow ? "#fff" : this.colours.ink;
      pen.fillText(text, x + wide / 2, top + 13.5, Math.max(wide - 4, 12));
      pen.restore();
    }
  }
}

function clockText(seconds, digits = 1) {
  const rounded = Number(Math.max(seconds, 0).toFixed(digits)), minutes = Math.floor(rounded / 60);
  return `${minutes}:${(rounded - 60 * minutes).toFixed(digits).padStart(digits ? digits + 3 : 2, "0")}`;
}
