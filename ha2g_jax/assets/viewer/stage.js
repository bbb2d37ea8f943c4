"use strict";
// The figures, each in its part of one canvas, with one camera for all.

const DISTANCE = 3.2; // metres from the eye to the spine, as in videos
const LIMB = 0.06, HAND = 0.17, FACE = 0.14; // metres of the body around a joint, of a mitten, of the head
const MARGIN = 0.04, KNEES = 0.95; // metres
const STRIP = 34; // pixels above figures for their names

class Stage {
  constructor(holder, motions, least = motions[0].body.view) {
    this.holder = holder;
    this.canvas = holder.querySelector("canvas");
    this.tip = holder.querySelector(".tip");
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    this.renderer.outputEncoding = THREE.sRGBEncoding;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.setScissorTest(true);
    this.scene = new THREE.Scene();
    this.light();
    const { shirts } = motions[0].body;
    this.shirts = motions.map((_, i) => shirts[i % shirts.length]);
    this.views = motions.map(() => [...least]); // left, top, right, bottom in metres from the spine, y down
    this.bodies = motions.map((motion, i) => new Body(motion, this.shirts[i], () => { this.isStale = true; }));
    for (const body of this.bodies) this.scene.add(body.group);
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.1, 20);
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { minDistance: 0.5, maxDistance: 8, zoomSpeed: 0.7, rotateSpeed: 0.7 });
    this.controls.addEventListener("change", () => { this.isStale = true; });
    this.controls.addEventListener("start", () => { this.isHome = false; });
    this.labels = motions.map((motion) => this.addLabel(motion.name));
    this.isOverlaid = this.hasSticks = false;
    this.slowness = this.before = 0;
    this.isHome = true;
    this.listen();
    this.layOut();
  }

  // Widens the view of a figure so that it shows a pose as a whole.
  include(figure, positions) {
    const { joints } = this.bodies[figure].motion, view = this.views[figure], before = view.join();
    joints.forEach((name, i) => {
      const near = DISTANCE / Math.max(DISTANCE - positions[3 * i + 2], 0.8);
      const isMitten = name.endsWith("_wrist") && !joints.includes("left_index_1");
      const reach = near * (isMitten ? HAND : /nose|eye|ear|head/.test(name) ? FACE : LIMB) + MARGIN;
      [near * positions[3 * i], -near * positions[3 * i + 1]].forEach((at, axis) => {
        view[axis] = Math.min(view[axis], at - reach);
        view[axis + 2] = Math.max(view[axis + 2], at + reach);
      });
    });
    this.isWider ||= view.join() !== before;
  }

  light() {
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xc8c2be, 0.78));
    const key = new THREE.DirectionalLight(0xfffaf2, 0.34);
    key.position.set(-1.2, 2.0, 2.6);
    key.castShadow = true;
    key.shadow.mapSize.set(1024, 1024);
    Object.assign(key.shadow.camera, { left: -0.9, right: 0.9, top: 0.9, bottom: -1.2, near: 1, far: 6 });
    key.shadow.radius = 3;
    key.shadow.bias = -0.001;
    key.shadow.normalBias = 0.02;
    const fill = new THREE.DirectionalLight(0xffffff, 0.08);
    fill.position.set(1.5, 0.2, 2.5);
    const rim = new THREE.DirectionalLight(0xcfe2ff, 0.30);
    rim.position.set(1.8, 1.0, -2.0);
    this.scene.add(key, fill, rim);
  }

  addLabel(name) {
    const label = document.createElement("div");
    label.className = "name";
    label.textContent = name;
    this.holder.append(label);
    return label;
  }

  listen() {
    new ResizeObserver(() => this.layOut()).observe(this.holder);
    this.canvas.addEventListener("pointermove", (event) => { this.pointer = event; this.isStale = true; });
    this.canvas.addEventListener("pointerleave", () => { this.pointer = null; this.isStale = true; });
    this.canvas.addEventListener("dblclick", () => this.resetView());
  }

  // Looks from the front at the whole view.
  resetView() {
    const { tall, low } = this.fitted;
    this.controls.target.set(0, tall / 2 - low, 0);
    this.camera.position.set(0, tall / 2 - low, DISTANCE);
    this.controls.update();
    this.isHome = this.isStale = true;
  }

  rotate(around, up) {
    const sphere = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    sphere.theta += around;
    sphere.phi = Math.min(Math.max(sphere.phi - up, 0.05), Math.PI - 0.05);
    this.camera.position.setFromSpherical(sphere).add(this.controls.target);
    this.controls.update();
    this.isHome = false;
  }

  turnTheme() {
    const root = document.documentElement;
    const now = root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    root.dataset.theme = now === "dark" ? "light" : "dark";
    this.isStale = true;
  }

  setLook({ isOverlaid = this.isOverlaid, hasSticks = this.hasSticks }) {
    Object.assign(this, { isOverlaid, hasSticks });
    this.bodies.forEach((body, i) => body.show({ hasSticks, isGhost: isOverlaid && i > 0 }));
    this.layOut();
  }

  // Uses the number of columns that makes the figures largest.
  layOut() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (!width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, [2, 1, 0.6][this.slowness]), pixels = `${width} ${height} ${ratio}`;
    if (pixels !== this.drawnSize) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
    }
    this.drawnSize = pixels;
    const { isOverlaid } = this, count = isOverlaid ? 1 : this.bodies.length;
    const [left, top, right, bottom] = [0, 1, 2, 3].map((k) => Math[k < 2 ? "min" : "max"](...this.views.map((view) => view[k])));
    const wide = isOverlaid ? right - left : Math.max(...this.views.map(([left, , right]) => right - left));
    const strip = this.labels.some((label) => label.textContent) ? STRIP * (isOverlaid ? this.bodies.length : 1) : 0;
    const size = (columns) =>
      Math.min(width / columns / wide, (height / Math.ceil(count / columns) - strip) / (bottom - top));
    const columns = [...Array(count).keys()].map((i) => i + 1).reduce((a, b) => (size(b) > size(a) ? b : a));
    const rows = Math.ceil(count / columns), scale = size(columns), tall = height / rows / scale;
    const spare = tall - strip / scale - (bottom - top); // of which the legs use half
    const low = Math.max(bottom, Math.min(bottom + spare / 2, KNEES));
    this.fitted = { tall, low }; // metres that are seen, and their lower end
    const above = (tall - low + top) * scale; // pixels above the figures
    this.parts = [...Array(count).keys()].map((i) => {
      const inRow = Math.floor(i / columns) === rows - 1 ? count - columns * (rows - 1) : columns;
      const [from, , to] = isOverlaid ? [left, top, right] : this.views[i];
      return {
        x: ((i % columns) + (columns - inRow) / 2) * (width / columns), shift: (-(from + to) / 2) * scale,
        y: Math.floor(i / columns) * (height / rows), width: width / columns, height: height / rows,
      };
    });
    this.labels.forEach((label, i) => {
      const part = this.parts[this.isOverlaid ? 0 : i];
      label.style.left = `${part.x + Math.max(2 * part.shift, 0)}px`;
      label.style.width = `${part.width - 2 * Math.abs(part.shift)}px`;
      label.style.top = `${part.y + above - strip + (isOverlaid ? STRIP * i : 0)}px`;
      label.style.setProperty("--shirt", this.shirts[i]);
    });
    if (this.isHome) this.resetView();
    this.isStale = true;
  }

  aim(part) {
    this.camera.fov = 2 * Math.atan(this.fitted.tall / 2 / DISTANCE) * (180 / Math.PI);
    this.camera.setViewOffset(part.width, part.height, -part.shift, 0, part.width, part.height);
  }

  draw(time, isSmooth) {
    this.bodies.forEach((body, i) => {
      const positions = body.motion.positionsAt(time, isSmooth);
      this.include(i, positions);
      body.pose(positions);
    });
    if (this.isWider) this.layOut();
    this.isWider = false;
    const height = this.holder.clientHeight;
    this.parts.forEach((part, i) => {
      this.bodies.forEach((body, k) => { body.group.visible = this.isOverlaid || k === i; });
      this.aim(part);
      const bottom = height - part.y - part.height;
      this.renderer.setViewport(part.x, bottom, part.width, part.height);
      this.renderer.setScissor(part.x, bottom, part.width, part.height);
      this.renderer.render(this.scene, this.camera);
    });
    this.nameJoint();
    this.isStale = false;
  }

  // On a slow computer switches shadows off, then reduces the resolution. Called for each image while playing.
  keepPace(now) {
    const isSlow = now - this.before > 55;
    this.before = now;
    this.slow = isSlow ? (this.slow || 0) + 1 : 0;
    if (this.slow < 6 || this.slowness > 1) return;
    this.slow = 0;
    this.slowness += 1;
    this.scene.traverse((part) => { if (part.isLight) part.castShadow = false; });
    this.layOut();
  }

  // Position of a joint in pixels of the canvas.
  onScreen(figure, joint) {
    const part = this.parts[this.isOverlaid ? 0 : figure];
    this.aim(part);
    const point = this.bodies[figure].joint(joint).clone().project(this.camera);
    return { x: part.x + ((point.x + 1) / 2) * part.width, y: part.y + ((1 - point.y) / 2) * part.height };
  }

  nameJoint() {
    let best = null;
    if (this.pointer && !this.pointer.buttons) {
      const box = this.canvas.getBoundingClientRect();
      const x = this.pointer.clientX - box.left, y = this.pointer.clientY - box.top;
      this.bodies.forEach((body, figure) => {
        const part = this.parts[this.isOverlaid ? 0 : figure];
        if (x < part.x || x > part.x + part.width || y < part.y || y > part.y + part.height) return;
        for (const joint of body.motion.joints) {
          const place = this.onScreen(figure, joint), distance = Math.hypot(place.x - x, place.y - y);
          if (distance < 16 && (!best || distance < best.distance)) best = { joint, distance, ...place };
        }
      });
    }
    this.tip.hidden = !best;
    if (!best) return;
    this.tip.querySelector("span").textContent = best.joint;
    this.tip.style.transform = `translate(${best.x}px, ${best.y}px)`;
  }
}
