"use strict";
// The figures, each in its part of one canvas, with one camera for all.

const SHIRTS = [0x3e6e9e, 0xb5583f, 0x4b8a63, 0x7d5a94, 0xb08a35, 0x3f8a91, 0x9c4668, 0x60707f];
const HOME = { eye: [0, 0.12, 2.5], target: [0, 0.07, 0.03] };

class Stage {
  constructor(holder, motions) {
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
    this.bodies = motions.map((motion, i) => new Body(motion, SHIRTS[i % SHIRTS.length]));
    for (const body of this.bodies) this.scene.add(body.group);
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.1, 20);
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { minDistance: 0.5, maxDistance: 6, zoomSpeed: 0.7, rotateSpeed: 0.7 });
    this.controls.addEventListener("change", () => { this.isStale = true; });
    this.labels = motions.map((motion) => this.addLabel(motion.name));
    this.isOverlaid = this.hasSticks = false;
    this.slowness = this.before = 0;
    this.resetView();
    this.listen();
    this.layOut();
  }

  light() {
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xa89c94, 0.70));
    const key = new THREE.DirectionalLight(0xfff4e6, 0.55);
    key.position.set(-1.2, 2.0, 2.6);
    key.castShadow = true;
    key.shadow.mapSize.set(1024, 1024);
    Object.assign(key.shadow.camera, { left: -0.9, right: 0.9, top: 0.9, bottom: -0.9, near: 1, far: 6 });
    key.shadow.radius = 3;
    key.shadow.bias = -0.001;
    key.shadow.normalBias = 0.02;
    const fill = new THREE.DirectionalLight(0xffffff, 0.18);
    fill.position.set(1.5, 0.2, 2.5);
    const rim = new THREE.DirectionalLight(0xcfe2ff, 0.45);
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

  resetView() {
    this.camera.position.set(...HOME.eye);
    this.controls.target.set(...HOME.target);
    this.controls.update();
    this.isStale = true;
  }

  rotate(around, up) {
    const sphere = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    sphere.theta += around;
    sphere.phi = Math.min(Math.max(sphere.phi - up, 0.05), Math.PI - 0.05);
    this.camera.position.setFromSpherical(sphere).add(this.controls.target);
    this.controls.update();
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

  // Uses the number of columns that makes the figures largest; a figure is higher than wide.
  layOut() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, [2, 1, 0.6][this.slowness]));
    this.renderer.setSize(width, height, false);
    const count = this.isOverlaid ? 1 : this.bodies.length;
    const size = (columns) => Math.min(width / columns / 0.8, height / Math.ceil(count / columns));
    const columns = [...Array(count).keys()].map((i) => i + 1).reduce((a, b) => (size(b) > size(a) ? b : a));
    const rows = Math.ceil(count / columns);
    this.parts = [...Array(count).keys()].map((i) => {
      const inRow = Math.floor(i / columns) === rows - 1 ? count - columns * (rows - 1) : columns;
      return {
        x: ((i % columns) + (columns - inRow) / 2) * (width / columns), y: Math.floor(i / columns) * (height / rows),
        width: width / columns, height: height / rows,
      };
    });
    this.labels.forEach((label, i) => {
      const part = this.parts[this.isOverlaid ? 0 : i];
      label.style.left = `${part.x}px`;
      label.style.width = `${part.width}px`;
      label.style.top = `${part.y + 10 + (this.isOverlaid ? 24 * i : 0)}px`;
      label.style.setProperty("--shirt", `#${SHIRTS[i % SHIRTS.length].toString(16)}`);
    });
    this.isStale = true;
  }

  aim(part) {
    this.camera.aspect = part.width / part.height;
    // A narrow part shows the same width of the scene.
    this.camera.fov = this.camera.aspect < 0.8 ? 2 * Math.atan(0.2 / this.camera.aspect) * (180 / Math.PI) : 28;
    this.camera.updateProjectionMatrix();
  }

  draw(time, isSmooth) {
    for (const body of this.bodies) body.pose(body.motion.positionsAt(time, isSmooth));
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
