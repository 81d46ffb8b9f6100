// The picture: who draws it, when, how finely. While something moves, what a slow machine cannot draw in time is left
// out, least significant Gaussians first; as soon as all stands still, everything is drawn.

import workerText from "worker-text";
import type { Camera, Pose } from "../camera";
import type { Splats } from "../protocol";
import { Card, isSoftware } from "./card";
import { lensOf } from "./project";
import type { Marks } from "./raster";
import { clamp } from "../vectors";
import type { Order, Reply } from "./worker";

const WANTED_MS = 40, REST_MS = 180, FEWEST = 20_000, COARSEST = 0.35, FIRST_SHARE = 0.1;
const MOST_DRAWN = 1_500_000; // in a picture by a processor, also where nothing moves

export class Stage {
  frames = 0; // pictures so far
  sorted = 0; // milliseconds that the last order of rows took
  background = [0.08, 0.09, 0.11];
  private readonly worker = new Worker(URL.createObjectURL(new Blob([workerText], { type: "text/javascript" })));
  private card: Card | null = null;
  private readonly pen: CanvasRenderingContext2D | null = null;
  private splats: Splats | null = null;
  private rgba: Uint8Array = new Uint8Array(0);
  private marks: Marks[] = [];
  private antialiased = false;
  private wanted = false;
  private busy: "no" | "moving" | "full" = "no"; // what the worker draws
  private stale = true; // the order of rows is of another pose
  private share = 1; // of the Gaussians, and of the pixels' number, while something moves
  private rest = 0;
  private lastFrame = 0;
  private moving = false;
  private drawn: Pose | null = null; // of the picture that the worker draws
  /** Called with each picture's pose, to draw over it. */
  over: (pose: Pose) => void = () => {};

  constructor(private canvas: HTMLCanvasElement, private readonly camera: Camera) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (gl && !isSoftware(gl)) this.card = new Card(gl);
    else {
      this.pen = this.flat(canvas, gl !== null);
      this.share = FIRST_SHARE;
    }
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => this.restore(gl));
    this.worker.onmessage = ({ data }: MessageEvent<Reply>) => this.replied(data);
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
  }

  get drawer(): "card" | "processor" { return this.card ? "card" : "processor"; }

  /** Return the pen of a canvas; one that gave a context of another kind is replaced. */
  private flat(canvas: HTMLCanvasElement, taken: boolean): CanvasRenderingContext2D | null {
    if (!taken) return canvas.getContext("2d");
    const other = canvas.cloneNode() as HTMLCanvasElement;
    canvas.replaceWith(other);
    this.canvas = other;
    return other.getContext("2d");
  }

  private restore(gl: WebGL2RenderingContext | null): void {
    if (!gl || !this.splats) return;
    this.card = new Card(gl);
    this.card.load(this.splats);
    this.card.recolor(this.rgba);
    this.card.mark(this.marks);
    this.draw();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    this.camera.width = Math.max(1, clientWidth);
    this.camera.height = Math.max(1, clientHeight);
    this.draw();
  }

  private tell(order: Order, transfer: Transferable[] = []): void { this.worker.postMessage(order, transfer); }

  /** Take another scene, or the same one with more rows, of `room` that will come. */
  hold(splats: Splats, antialiased: boolean, from = 0, room = splats.count): void {
    if (this.card && splats.count > this.card.room) throw new Error(`this graphics card holds ${this.card.room.toLocaleString()} Gaussians, and there are ${splats.count.toLocaleString()}`);
    this.splats = splats;
    this.antialiased = antialiased;
    this.card?.load(splats);
    const centers = splats.centers.slice(3 * from), covariances = splats.covariances.slice(6 * from), opacity = splats.opacity.slice(from);
    this.tell({ do: "hold", rows: { room, from, centers, covariances, opacity }, antialiased }, [centers.buffer, covariances.buffer, opacity.buffer]);
    this.moves(); // coarsely at first: more rows may follow
  }

  /** Take other places of the first rows. */
  move(upto: number): void {
    const splats = this.splats;
    if (!splats) return;
    this.card?.move(splats, upto);
    this.tell({ do: "move", centers: splats.centers.slice(0, 3 * upto), covariances: splats.covariances.slice(0, 6 * upto) });
    this.moves();
  }

  paint(rgba: Uint8Array): void {
    this.rgba = rgba;
    this.card?.recolor(rgba);
    this.tell({ do: "paint", rgba });
    this.stale = true;
    this.draw();
  }

  /** Outline some rows. */
  mark(marks: Marks[]): void {
    this.marks = marks;
    this.card?.mark(marks);
    this.tell({ do: "mark", marks });
    this.draw();
  }

  /** Draw again, since the camera or the scene moves. */
  moves(): void {
    this.moving = true;
    this.stale = true;
    this.settle();
    this.draw();
  }

  /** Draw everything once all stands still; what flies moves also where a busy machine draws it seldom. */
  private settle(): void {
    clearTimeout(this.rest);
    this.rest = window.setTimeout(() => {
      if (this.camera.isFlying) { this.settle(); return; }
      this.moving = false;
      this.lastFrame = 0;
      this.stale = true;
      this.draw();
    }, REST_MS);
  }

  draw(): void {
    if (this.wanted) return;
    this.wanted = true;
    requestAnimationFrame((now) => {
      this.wanted = false;
      this.camera.advance(now);
      this.frame(now);
      if (this.camera.isFlying) this.moves();
    });
  }

  /** Rows that a picture has room for. */
  private get limit(): number {
    const count = this.splats?.count ?? 0, whole = this.card ? count : Math.min(count, MOST_DRAWN);
    return this.moving ? Math.max(Math.min(count, FEWEST), Math.round(whole * this.share)) : whole;
  }

  private get ratio(): number {
    const full = Math.min(2, devicePixelRatio || 1), floor = this.card ? 0.5 : COARSEST;
    return this.moving ? full * Math.max(floor, Math.sqrt(this.share)) : full;
  }

  /** Draw more or less the next time, by how long this picture took. */
  private pace(ms: number): void {
    if (!this.moving || ms <= 0) return;
    if (ms > WANTED_MS) this.share = Math.max(0.02, this.share * Math.max(0.6, WANTED_MS / ms));
    else if (ms < WANTED_MS / 2) this.share = Math.min(1, this.share * 1.15);
  }

  private frame(now: number): void {
    if (!this.splats) return;
    const pose = this.camera.pose();
    if (this.stale && (this.busy === "no" || (this.busy === "full" && !this.card))) { // a new order to draw ends a long one
      this.busy = this.moving ? "moving" : "full";
      this.stale = false;
      this.drawn = pose;
      const lens = lensOf(pose, this.ratio), limit = this.limit;
      this.tell(this.card ? { do: "sort", lens, limit } : { do: "draw", lens, limit, background: this.background });
    }
    if (!this.card) return;
    if (this.moving && this.lastFrame) this.pace(now - this.lastFrame);
    this.lastFrame = this.moving ? now : 0;
    const ratio = this.ratio, [w, h] = [Math.round(pose.width * ratio), Math.round(pose.height * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    this.card.draw(pose, ratio, this.background, this.antialiased);
    this.over(pose);
    this.frames += 1;
  }

  private replied(reply: Reply): void {
    const was = this.busy;
    this.busy = "no";
    this.sorted = reply.sorted;
    if (reply.done === "sort") {
      this.card?.order(reply.rows);
      this.draw();
      return;
    }
    const { width, height } = reply.lens;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.pen?.putImageData(new ImageData(reply.picture, width, height), 0, 0);
    if (was === "full") this.share = clamp(Math.sqrt(WANTED_MS / reply.ms), 0.02, 1); // so that the next movement starts smoothly
    else this.pace(reply.ms);
    if (this.drawn) this.over(this.drawn);
    this.frames += 1;
    if (this.stale) this.draw();
  }
}
