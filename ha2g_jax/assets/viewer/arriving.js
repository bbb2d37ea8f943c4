"use strict";
// Frames that a server sends, and the pose at any time between them.

const KEPT = 30; // frames before the one that is shown
const MOST_SECONDS = 15; // of frames that wait; a page in a hidden tab does not draw them
const EASE = 0.4; // seconds in which the figure goes to a pose that does not follow from the one before

class ArrivingMotion extends Figure {
  constructor(figure) {
    super({ name: "", ...figure });
    Object.assign(this, { fps: figure.fps, axes: figure.axes, frames: [] });
    this.rest = this.read(figure.rest);
    this.pose = Float32Array.from(this.rest);
    this.ease();
  }

  // A pose in the axes of the page from one in those of the skeleton.
  read(row) {
    if (row.length !== 3 * this.bones.length) throw new Error(`a frame of ${row.length} numbers`);
    return Float32Array.from(row, (value, i) => value * this.axes[i % 3]);
  }

  add(first, rows) {
    if (!this.frames.length) this.ease();
    rows.forEach((row, i) => this.frames.push({ number: first + i, directions: this.read(row) }));
    this.frames.splice(0, this.frames.length - MOST_SECONDS * this.fps);
  }

  clear() {
    this.frames = [];
    this.shown = null;
    this.ease();
  }

  // Go from the present pose to what is shown next within a moment.
  ease() {
    this.from = Float32Array.from(this.pose);
    this.easedSince = performance.now();
  }

  get isEasing() { return performance.now() - this.easedSince < 1000 * EASE; }

  get last() { return this.frames.length ? this.frames[this.frames.length - 1].number : -1; }

  // The frames about a number, and how far it is from the first to the second; before and after all frames the nearest.
  around(number) {
    while (this.frames.length > KEPT && this.frames[KEPT].number <= number) this.frames.shift();
    let next = this.frames.findIndex((frame) => frame.number > number);
    if (next < 0) next = this.frames.length;
    const a = this.frames[Math.max(next - 1, 0)], b = this.frames[Math.min(next, this.frames.length - 1)];
    const weight = b.number > a.number ? (number - a.number) / (b.number - a.number) : 0;
    return { a, b, weight, shown: a.number + weight * (b.number - a.number) };
  }

  // Positions (joints x 3) in metres of a frame number with a fraction; of the rest pose where there is no frame.
  positionsAt(number) {
    const isRest = number === null || !this.frames.length;
    const { a, b, weight, shown } = isRest ? { a: null, b: null, weight: 0, shown: null } : this.around(number);
    const from = isRest ? this.rest : a.directions, to = isRest ? this.rest : b.directions;
    const time = Math.min((performance.now() - this.easedSince) / (1000 * EASE), 1), eased = time * time * (3 - 2 * time);
    for (let i = 0; i < this.pose.length; i++) {
      const target = from[i] + weight * (to[i] - from[i]);
      this.pose[i] = eased < 1 ? this.from[i] + eased * (target - this.from[i]) : target;
    }
    this.shown = shown;
    return this.place((bone) => this.pose.subarray(3 * bone, 3 * bone + 3));
  }
}
