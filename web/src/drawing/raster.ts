// A rasteriser for machines without a graphics card: Gaussians blended front to back, in this thread.
// It is the same sum as the renderer's: color = sum of c_i * alpha_i * T_i (method.md, blending weights).

import type { Chunks } from "./chunks";
import type { Held, Lens } from "./held";
import { project, Sorter, type Footprint } from "./project";

const STEPS = 2048, FARTHEST2 = 9, LEAST_ALPHA = 1 / 255, DONE = 0.004, A_STEP = 4096;
const FALLOFF = Float32Array.from({ length: STEPS + 1 }, (_, k) => Math.exp((-0.5 * FARTHEST2 * k) / STEPS));

/** Rows that are outlined, in one colour (0 to 1 each). */
export interface Marks { rows: Uint32Array; color: number[] }

export class Raster {
  readonly sorter = new Sorter();
  private sums = new Float32Array(0); // red, green, blue, what is left of the light
  private readonly foot: Footprint = { x: 0, y: 0, xx: 1, xy: 0, yy: 1, alpha: 0 };

  /** Draw what a lens sees over a background (0 to 1), in steps that yield; return RGBA pixels. */
  *draw(held: Held, chunks: Chunks, lens: Lens, background: number[], limit: number): Generator<void, Uint8ClampedArray<ArrayBuffer>> {
    const pixels = lens.width * lens.height, sums = this.cleared(pixels), rows = this.sorter.sorted(held, chunks, lens, limit);
    for (let begin = 0; begin < rows.length; begin += A_STEP) {
      for (const i of rows.subarray(begin, begin + A_STEP)) {
        const at = 4 * i;
        this.splat(held, i, lens, held.rgba[at] / 255, held.rgba[at + 1] / 255, held.rgba[at + 2] / 255);
      }
      yield;
    }
    const out = new Uint8ClampedArray(4 * pixels), [r, g, b] = background;
    for (let p = 0; p < 4 * pixels; p += 4) {
      const left = sums[p + 3];
      out[p] = 255 * (sums[p] + left * r);
      out[p + 1] = 255 * (sums[p + 1] + left * g);
      out[p + 2] = 255 * (sums[p + 2] + left * b);
      out[p + 3] = 255;
    }
    return out;
  }

  /** Draw the outlines of some rows over a picture, as they are without what is before them. */
  outline(picture: Uint8ClampedArray, held: Held, lens: Lens, marks: Marks[], radius: number): void {
    const { width, height } = lens;
    for (const { rows, color } of marks) {
      const sums = this.cleared(width * height);
      for (const i of rows) this.splat(held, i, lens, 0, 0, 0);
      const inside = (x: number, y: number) => sums[4 * (Math.min(height - 1, Math.max(0, y)) * width + Math.min(width - 1, Math.max(0, x))) + 3] < 0.5;
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
          if (inside(x, y) || !(inside(x - radius, y) || inside(x + radius, y) || inside(x, y - radius) || inside(x, y + radius))) continue;
          picture.set([255 * color[0], 255 * color[1], 255 * color[2], 255], 4 * (y * width + x));
        }
      }
    }
  }

  private cleared(pixels: number): Float32Array {
    if (this.sums.length < 4 * pixels) this.sums = new Float32Array(4 * pixels);
    this.sums.fill(0);
    for (let p = 3; p < 4 * pixels; p += 4) this.sums[p] = 1;
    return this.sums;
  }

  private splat(held: Held, i: number, lens: Lens, red: number, green: number, blue: number): void {
    const foot = this.foot, sums = this.sums;
    if (!project(held, i, lens, foot) || foot.alpha < LEAST_ALPHA) return;
    const { xx, xy, yy, alpha } = foot, det = xx * yy - xy * xy;
    if (!(det > 0)) return;
    const a = yy / det, b = -xy / det, c = xx / det, reach2 = Math.min(FARTHEST2, 2 * Math.log(alpha / LEAST_ALPHA));
    const tall = Math.sqrt(reach2 * yy), first = Math.max(0, Math.ceil(foot.y - tall - 0.5)), last = Math.min(lens.height - 1, Math.floor(foot.y + tall - 0.5));
    for (let y = first; y <= last; y++) {
      const dy = y + 0.5 - foot.y, middle = (-b * dy) / a, span2 = middle * middle - (c * dy * dy - reach2) / a;
      if (span2 < 0) continue;
      const span = Math.sqrt(span2), begin = Math.max(0, Math.ceil(foot.x + middle - span - 0.5)), end = Math.min(lens.width - 1, Math.floor(foot.x + middle + span - 0.5));
      for (let x = begin, p = 4 * (y * lens.width + begin); x <= end; x++, p += 4) {
        const left = sums[p + 3];
        if (left < DONE) continue;
        const dx = x + 0.5 - foot.x, far = a * dx * dx + 2 * b * dx * dy + c * dy * dy;
        const covered = Math.min(0.99, alpha * FALLOFF[((far * STEPS) / FARTHEST2) | 0]), weight = covered * left;
        sums[p] += weight * red;
        sums[p + 1] += weight * green;
        sums[p + 2] += weight * blue;
        sums[p + 3] = left - weight;
      }
    }
  }
}
