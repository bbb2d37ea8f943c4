/** Classes of the scripts of ha2g_jax/assets/viewer, which the page loads before the module. */

interface FigureFacts {
  joints: string[];
  bones: [number, number][];
  lengths: number[];
  fps: number;
  axes: number[];
  rest: number[];
  body: object;
}

interface ArrivedFrame {
  number: number;
  directions: Float32Array;
}

declare class ArrivingMotion {
  constructor(figure: FigureFacts);
  readonly fps: number;
  readonly joints: string[];
  readonly bones: [number, number][];
  frames: ArrivedFrame[];
  rest: Float32Array;
  pose: Float32Array;
  shown: number | null;
  readonly isEasing: boolean;
  readonly last: number;
  place(direction: (bone: number) => Float32Array): Float32Array;
  read(row: ArrayLike<number>): Float32Array;
  add(first: number, rows: ArrayLike<number>[]): void;
  clear(): void;
  ease(): void;
  around(number: number): { a: ArrivedFrame; b: ArrivedFrame; weight: number; shown: number };
  positionsAt(number: number | null): Float32Array;
}

declare class Stage {
  constructor(holder: Element, motions: ArrivingMotion[]);
  readonly canvas: HTMLCanvasElement;
  isStale: boolean;
  hasSticks: boolean;
  resetView(): void;
  rotate(around: number, up: number): void;
  turnTheme(): void;
  setLook(look: { hasSticks: boolean }): void;
  include(figure: number, positions: Float32Array): void;
  keepPace(now: number): void;
  draw(number: number | null, isSmooth: boolean): void;
}

/** What a button of `Acting` asks for. */
interface Asked {
  state?: "auto" | "idle" | "listen" | "think";
  cue?: string;
  clear?: boolean;
}

declare class Acting {
  constructor(holder: Element, cues: string[], act: (asked: Asked) => void);
  readonly isOther: boolean;
  showState(state: string): void;
}

declare class Timeline {
  constructor(
    canvas: HTMLCanvasElement,
    content: { duration: number; words: never[]; peakRate: number },
    peaks: Uint8Array,
    seek: (time: number) => void,
  );
  draw(time: number): void;
}

declare function clockText(seconds: number, digits?: number): string;
