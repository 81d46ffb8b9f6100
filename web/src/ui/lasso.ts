// A box or a line drawn around something selects what is mostly visible inside of it.

import type { App } from "./app";
import { byId } from "./dom";

const LEAST_STEP = 4;

export class Lasso {
  private kind: "box" | "lasso" | null = null;
  private points: [number, number][] = [];
  private readonly canvas = byId<HTMLCanvasElement>("lasso");

  constructor(private readonly app: App) {
    this.canvas.addEventListener("pointerdown", (event) => { this.canvas.setPointerCapture(event.pointerId); this.points = [[event.offsetX, event.offsetY]]; });
    this.canvas.addEventListener("pointermove", (event) => this.drag(event.offsetX, event.offsetY));
    this.canvas.addEventListener("pointerup", () => this.end());
    this.canvas.addEventListener("pointercancel", () => this.stop());
  }

  get isDrawing(): boolean { return this.kind !== null; }

  begin(kind: "box" | "lasso"): void {
    this.kind = kind;
    this.points = [];
    this.canvas.hidden = false;
    Object.assign(this.canvas, { width: this.canvas.clientWidth, height: this.canvas.clientHeight });
    document.body.classList.add("low");
    this.app.say(kind === "box" ? "Drag a box around what you mean. Escape stops." : "Draw around what you mean. Escape stops.");
  }

  stop(): void {
    if (!this.kind) return;
    this.kind = null;
    this.canvas.hidden = true;
    document.body.classList.remove("low");
  }

  private drag(x: number, y: number): void {
    const first = this.points[0], last = this.points[this.points.length - 1];
    if (!first) return;
    if (this.kind === "box") this.points = [first, [x, first[1]], [x, y], [first[0], y]];
    else if (Math.hypot(x - last[0], y - last[1]) >= LEAST_STEP && this.points.length < 1000) this.points.push([x, y]);
    const pen = this.canvas.getContext("2d");
    if (!pen) return;
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.beginPath();
    this.points.forEach(([px, py]) => pen.lineTo(px, py));
    pen.closePath();
    pen.fillStyle = "rgba(255,170,30,.15)";
    pen.strokeStyle = "#ffaa1e";
    pen.lineWidth = 2;
    pen.fill();
    pen.stroke();
  }

  private end(): void {
    const polygon = this.points;
    this.stop();
    this.app.say("");
    if (polygon.length >= 3) void this.app.act({ act: "lasso", polygon, camera: this.app.place });
  }
}
