// The documents that the client shows: the same ones from a page's own file and from a running viewer.
// Positions are in the browser's frame (the scene at a radius of ten units); cameras have +x right, +y down, +z ahead.

import type { Vec } from "./vectors";

export type Color = [number, number, number]; // 0 to 255

export interface Box { center: Vec; axes: [Vec, Vec, Vec]; extent: Vec }

/** A place that can be flown to. `boxes`: where it is at each time of a page's scene that moves, null where it is gone. */
export interface Place extends Box { eye: Vec; boxes?: (number[] | null)[]; gone?: boolean }

export interface Match extends Place { score: number; size: string; place: string; num_gaussians: number; name: string; sure?: boolean; object?: number }

export interface Result {
  text: string; summary: string; doubt: string; accent: Color; matches: Match[]; num_matches: number;
  threshold: number; automatic: number; limits: [number, number]; measure: string; threshold_rule: string; exact: boolean; certainty?: "sure" | "maybe" | "nothing";
  instead?: string[]; // words that have a match where this has none
}

export interface SceneObject extends Place { number: number; name: string; unsure: boolean; size: string; num_gaussians: number; picture?: string }

export interface Annotation { text: string; center: Vec; eye: Vec; axes?: [Vec, Vec, Vec]; extent?: Vec }

export interface Photo { name: string; eye: Vec; target: Vec; up: Vec; fov: number; width: number; height: number }

/** How answers are painted: light and floor that the rest keeps, colour that it loses, share of a query's colour. */
export interface Look { dim: number; floor: number; greyed: number; tint: number }

export interface Can {
  ask: boolean; ask_picture: boolean; objects: boolean; name: boolean; edit: boolean; time: boolean; photos: boolean;
  save_dir: boolean; catalogue: boolean; open: boolean; film_formats: string[];
}

export interface Header {
  title: string; about: string; eye: Vec; target: Vec; up: Vec; fov: number; heat: Color[]; look: Look; antialiased: boolean;
  words: string[]; modes: Mode[]; can: Can; objects: SceneObject[]; photos: Photo[];
  times: { first: number; last: number; count: number; seconds: number } | null;
  film: Film | null; plays: boolean; tiles?: TiledScene | null; knows?: string;
}

/** A scene in tiles, of which a browser should hold `budget` rows. coarse: rows of a tile's coarse part, of all its rows. */
export interface TiledScene { budget: number; tiles: { coarse: number; rows: number; low: Vec; high: Vec }[] }

/** Places along a path, near enough to each other for straight lines. */
export interface Film { seconds: number; eyes: Vec[]; targets: Vec[]; fovs: number[] }

/** What colours say; the values are those of the Python session. */
export type Mode = "answer" | "heat map" | "as it is" | "features" | "classes" | "objects";

export interface Clicked {
  name: string; words: { text: string; score: number }[]; place: string;
  support: { view: string; mask: number; share: number }[]; photo: boolean;
}

export interface Chosen {
  name: string; number: number | null; smaller: boolean; larger: boolean; num_gaussians: number; photos: number; label: boolean;
}

export interface State {
  revision: number; scene: number; header: number; geometry: number; paint: number; mode: Mode; message: string; selection: number;
  results: Result[]; clicked: Clicked | null; chosen: Chosen | null;
  classes: { name: string; count: number; color: Color }[] | null;
  edits: { number: number; what: string; target: string; done: boolean }[]; can_undo: boolean; can_redo: boolean;
  annotations: Annotation[]; time: { at: number; during: [number, number] | null } | null; kept: boolean;
  asked?: string[]; present?: boolean; // the queries in words that are answered, and whether they are known to be there
}

/** Per row of the splats: how well it answers, whose answer it is (0: nobody's), its object. */
export interface Paint { heat: Uint8Array; owner: Uint8Array; object: Uint16Array | null }

/** Gaussians in the browser's frame. covariances: float16 bits, xx xy xz yy yz zz. */
export interface Splats { count: number; centers: Float32Array; covariances: Uint16Array; rgb: Uint8Array; opacity: Uint8Array }

/** Rows so far. room: how many there will be. all: how many the scene has. */
export interface Growing { splats: Splats; room: number; all: number }

export interface CameraPlace { eye: Vec; target: Vec; fov: number; width: number; height: number }

export type Act = { act: string; [key: string]: unknown };

/** Where documents come from. Every act returns the state after it; a refusal throws an Error with a sentence. */
export interface Backend {
  header(): Promise<Header>;
  state(): Promise<State>;
  /** Yield a scene, and then again with more and more rows behind those that were there. */
  splats(): AsyncGenerator<Growing>;
  /** Return what the first rows answer. */
  paint(count: number): Promise<Paint>;
  colors(mode: Mode, count: number): Promise<Uint8Array>;
  act(act: Act): Promise<State>;
  /** Hear of changes that others made. */
  listen(changed: (state: State) => void): void;
  objectPicture(object: SceneObject): string;
  /** Return texts to go on with what is typed, and all words that are known, under heads; a page alone knows them. */
  suggest?(typed: string): string[];
  known?(): [string, string[]][];
  live: Live | null;
}

/** What only a running viewer can do. */
export interface Live {
  /** Return some parts of a scene in tiles, one after the other. */
  tiles(parts: number[]): Promise<Splats>;
  /** Return what the same rows answer, and their colours in modes that only the service knows. */
  tilesPaint(parts: number[]): Promise<{ paint: Paint; colors: Uint8Array | null }>;
  /** Rows that this browser has room for. */
  readonly room: number;
  photo(photo: Photo, side: number): string;
  clickedPhoto(): string;
  askPicture(file: File): Promise<State>;
  open(files: { name: string; file: File }[]): Promise<State>;
  /** Return a file that the service makes; saved beside the scene, too, where that was asked for at its start. */
  file(path: string, body: unknown): Promise<{ blob: Blob; name: string; saved: string }>;
  /** Return the places between key frames, as the film that would be saved has them. */
  flight(keys: KeyFrame[], seconds: number | null): Promise<Film>;
  /** Return how many pictures of a film are drawn, of how many; 0 of 0 while it waits. */
  filmProgress(job: string): Promise<{ done: number; count: number }>;
  loadPath(file: File): Promise<{ keys: KeyFrame[]; seconds: number | null }>;
  catalogue(text: string): Promise<{ summary: string; entries: { number: number; title: string; scene: string; score: number }[] }>;
  cataloguePicture(number: number): string;
}

export interface KeyFrame { eye: Vec; target: Vec; fov: number }
