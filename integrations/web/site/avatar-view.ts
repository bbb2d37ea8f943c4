/** The visitor's avatar on a canvas of its own. Its code, with three.js, is loaded when an avatar is opened. */

import { VRMUtils, type VRM } from "@pixiv/three-vrm";
import { Box3, DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, Spherical, Vector3 } from "three";
import { WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { loadVrm, poseVrm } from "../src/adapters/vrm.js";
import type { Skeleton } from "../src/description.js";
import { LivePoses } from "../src/motion/poses.js";

const FPS = 60; // of the images
const MOST_STEP = 0.1; // seconds between two images, for hair and clothes
const MOST_LETTERS = 80; // of a name

export class AvatarView {
  isStale = true;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(28, 1, 0.05, 30);
  private readonly controls: OrbitControls;
  private readonly renderer: WebGLRenderer;
  private readonly poses: LivePoses;
  private readonly watcher = new ResizeObserver(() => this.layOut());
  private before = performance.now();

  /** @param name - name and authors, as the file states them. */
  constructor(
    private readonly vrm: VRM,
    readonly name: string,
    private readonly canvas: HTMLCanvasElement,
    skeleton: Skeleton,
  ) {
    this.poses = new LivePoses(skeleton, FPS, "vrm");
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.minDistance = 0.5;
    this.controls.maxDistance = 8;
    this.controls.addEventListener("change", () => (this.isStale = true));
    const key = new DirectionalLight(0xfff4e6, 1.8);
    key.position.set(-1.2, 2, 2.6);
    this.scene.add(new HemisphereLight(0xffffff, 0xa89c94, 1.6), key, vrm.scene);
    this.watcher.observe(canvas.parentElement as Element);
    this.layOut();
    this.resetView();
  }

  /** Draws a pose, (bones, 3) unit vectors in the axes of the skeleton. */
  draw(directions: Float32Array): void {
    const now = performance.now();
    poseVrm(this.vrm, this.poses.animate(directions).at(0));
    this.vrm.update(Math.min((now - this.before) / 1000, MOST_STEP));
    this.before = now;
    this.renderer.render(this.scene, this.camera);
    this.isStale = false;
  }

  /** Looks at the upper body from the front. */
  resetView(): void {
    const head = this.vrm.humanoid.getRawBoneNode("head")?.getWorldPosition(new Vector3());
    const top = head?.y ?? new Box3().setFromObject(this.vrm.scene).max.y;
    this.controls.target.set(0, 0.78 * top, 0);
    this.camera.position.set(0, 0.84 * top, 1.75 * top);
    this.controls.update();
    this.isStale = true;
  }

  rotate(around: number, up: number): void {
    const sphere = new Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    sphere.theta += around;
    sphere.phi = Math.min(Math.max(sphere.phi - up, 0.05), Math.PI - 0.05);
    this.camera.position.setFromSpherical(sphere).add(this.controls.target);
    this.controls.update();
  }

  close(): void {
    this.watcher.disconnect();
    this.controls.dispose();
    VRMUtils.deepDispose(this.vrm.scene);
    this.renderer.dispose();
  }

  private layOut(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement as Element;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // A narrow canvas shows the same width of the scene.
    this.camera.fov = this.camera.aspect < 0.8 ? 2 * Math.atan(0.2 / this.camera.aspect) * (180 / Math.PI) : 28;
    this.camera.updateProjectionMatrix();
    this.isStale = true;
  }
}

/**
 * Opens an avatar of unknown origin.
 *
 * @param bytes - contents of a .vrm file.
 * @throws Error if it cannot be used.
 */
export async function openAvatar(
  bytes: ArrayBuffer,
  canvas: HTMLCanvasElement,
  skeleton: Skeleton,
): Promise<AvatarView> {
  const { vrm, metadata } = await loadVrm(bytes);
  const name = metadata.name ?? metadata.title ?? "";
  const authors = metadata.authors ?? metadata.author ?? "";
  const whole = [name || "an avatar without a name", authors && `by ${authors}`].filter(Boolean).join(" ");
  const shown = whole.length > MOST_LETTERS ? `${whole.slice(0, MOST_LETTERS)}...` : whole;
  return new AvatarView(vrm, shown, canvas, skeleton);
}
