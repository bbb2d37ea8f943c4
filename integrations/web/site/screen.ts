/** What is drawn: the figure of the viewer, or the avatar of the visitor. */

import type { Skeleton } from "../src/description.js";
import { fileOf, find, press, show } from "./elements.js";
import type { ShownFigure } from "./figure.js";
import type { AvatarView } from "./avatar-view.js";

const MAX_AVATAR_BYTES = 100 * 2 ** 20; // checkVrm refuses larger ones

export class Screen {
  private readonly stage: Stage;
  private avatar: AvatarView | null = null;
  private wasMoving = false;

  constructor(
    private readonly figure: ShownFigure,
    private readonly skeleton: Skeleton,
  ) {
    this.stage = new Stage(find("#stage"), [figure]);
  }

  /** The canvas that is shown. */
  get canvas(): HTMLCanvasElement {
    return find<HTMLCanvasElement>(this.avatar ? "#avatar" : "#figure");
  }

  get hasAvatar(): boolean {
    return this.avatar !== null;
  }

  /**
   * Shows an avatar, whose code is loaded now.
   *
   * @returns its name, as its file states it.
   * @throws Error with a sentence for people.
   */
  async wear(file: File): Promise<string> {
    if (!file.size) throw new Error(`${file.name} is empty.`);
    if (file.size > MAX_AVATAR_BYTES) throw new Error(`${file.name} is larger than ${MAX_AVATAR_BYTES / 2 ** 20} MiB.`);
    const { openAvatar } = (await import(fileOf("vrm.js").href)) as typeof import("./avatar-view.js");
    const canvas = find<HTMLCanvasElement>("#avatar");
    const avatar = await openAvatar(await file.arrayBuffer(), canvas, this.skeleton).catch((error: Error) => {
      throw new Error(`${file.name} cannot be shown: ${error.message}`);
    });
    this.avatar?.close();
    this.avatar = avatar;
    this.change();
    return avatar.name;
  }

  /** Shows the figure again. */
  undress(): void {
    this.avatar?.close();
    this.avatar = null;
    this.change();
  }

  /** Widens the view so that the whole motion of the figure is in it. */
  fit(): void {
    for (const { directions } of this.figure.frames) {
      this.stage.include(0, this.figure.place((bone) => directions.subarray(3 * bone, 3 * bone + 3)));
    }
  }

  resetView(): void {
    this.avatar?.resetView();
    this.stage.resetView();
  }

  rotate(around: number, up: number): void {
    if (this.avatar) this.avatar.rotate(around, up);
    else this.stage.rotate(around, up);
  }

  turnTheme(): void {
    this.stage.turnTheme();
    if (this.avatar) this.avatar.isStale = true;
  }

  turnBones(): void {
    this.stage.setLook({ hasSticks: !this.stage.hasSticks });
    press(find("#bones"), this.stage.hasSticks);
  }

  /** Draws again even if nothing moves. */
  refresh(): void {
    this.stage.isStale = true;
    if (this.avatar) this.avatar.isStale = true;
  }

  /**
   * Draws a frame if something has changed.
   *
   * @param number - number of the frame, with a fraction; null for the pose without motion.
   * @param isMoving - whether the next image will be another.
   * @returns Whether it has drawn.
   */
  draw(number: number | null, isMoving: boolean, now: number): boolean {
    const moves = isMoving || this.figure.isEasing;
    const isStale = this.avatar ? this.avatar.isStale : this.stage.isStale;
    if (!moves && !this.wasMoving && !isStale) return false;
    this.wasMoving = moves;
    if (this.avatar) {
      this.figure.positionsAt(number);
      this.avatar.draw(this.figure.directions);
    } else {
      if (moves) this.stage.keepPace(now);
      this.stage.draw(number, true);
    }
    return true;
  }

  private change(): void {
    show(this.hasAvatar, "#avatar");
    show(!this.hasAvatar, "#figure", "#bones");
    find("#wear").textContent = this.hasAvatar ? "Figure" : "Avatar";
    this.refresh();
  }
}
