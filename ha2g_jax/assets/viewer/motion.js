"use strict";
// Unpacks the data of ha2g_jax/viewer/packing.py and computes the joints at any time. y is up, the person faces +z.

// Runs three.js, which the page has in compressed form.
async function loadThree() {
  const library = document.querySelector("#three").textContent, script = document.createElement("script");
  script.src = URL.createObjectURL(new Blob([await inflated(library)], { type: "text/javascript" }));
  await new Promise((resolve, reject) => {
    Object.assign(script, { onload: resolve, onerror: reject });
    document.head.append(script);
  });
}

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

async function inflated(base64) {
  const stream = new Blob([bytesOf(base64)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// A tree of joints. `name` is the label of the figure, `body` what it is drawn with.
class Figure {
  constructor({ name, joints, bones, lengths, body }) {
    Object.assign(this, { name, joints, bones, lengths, body });
    this.order = this.fromTheRoot();
    this.positions = new Float32Array(3 * joints.length);
  }

  // Bones in an order in which each comes after its parent.
  fromTheRoot() {
    const order = [], reached = new Set([0]);
    while (order.length < this.bones.length) {
      this.bones.forEach(([parent, child], bone) => {
        if (reached.has(parent) && !reached.has(child)) { order.push(bone); reached.add(child); }
      });
    }
    return order;
  }

  // Positions (joints x 3) in metres of a pose; `direction(bone)` is a vector of any length.
  place(direction) {
    const positions = this.positions;
    for (const bone of this.order) {
      const [parent, child] = this.bones[bone], vector = direction(bone);
      const scale = this.lengths[bone] / (Math.hypot(...vector) || 1);
      for (let i = 0; i < 3; i++) positions[3 * child + i] = positions[3 * parent + i] + scale * vector[i];
    }
    return positions;
  }
}

class MotionData extends Figure {
  static async unpack(packed, levels) {
    const planes = await inflated(packed.directions);
    const count = planes.length / 2, frames = packed.frames;
    const codes = new Int16Array(count);
    for (let row = 0; row < count; row += frames) {
      let value = 0;
      for (let i = row; i < row + frames; i++) {
        const zigzag = planes[i] | (planes[count + i] << 8);
        value += zigzag & 1 ? -((zigzag + 1) >> 1) : zigzag >> 1;
        codes[i] = value;
      }
    }
    return new MotionData(packed, levels, codes);
  }

  constructor(packed, levels, codes) {
    super(packed);
    Object.assign(this, { fps: packed.fps, frames: packed.frames, levels, codes });
  }

  // Frame k shows the time k / fps; a time that is a frame but for rounding errors is that frame.
  frameTime(time) {
    return Math.min(Math.max(time * this.fps, 0), this.frames - 1);
  }

  frameAt(time) {
    return Math.floor(this.frameTime(time) + 1e-4);
  }

  direction(bone, frame, out) {
    const half = this.levels / 2, row = 2 * bone * this.frames + frame;
    let x = this.codes[row] / half - 1, y = this.codes[row + this.frames] / half - 1;
    const z = 1 - Math.abs(x) - Math.abs(y);
    if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
    const length = Math.hypot(x, y, z);
    out[0] = x / length; out[1] = y / length; out[2] = z / length;
    return out;
  }

  // Positions (joints x 3) in metres at a time; between two frames directions are interpolated.
  positionsAt(time, isSmooth = true) {
    const frame = this.frameAt(time), next = Math.min(frame + 1, this.frames - 1);
    const fraction = isSmooth ? Math.max(this.frameTime(time) - frame, 0) : 0;
    const a = [0, 0, 0], b = [0, 0, 0];
    return this.place((bone) => {
      this.direction(bone, frame, a);
      if (fraction > 0) {
        this.direction(bone, next, b);
        for (let i = 0; i < 3; i++) a[i] += fraction * (b[i] - a[i]);
      }
      return a;
    });
  }
}
