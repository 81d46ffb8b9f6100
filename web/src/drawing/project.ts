// The projection of Gaussians into a picture, as both painters have it (paper supplement: EWA splatting).

import type { Pose } from "../camera";
import { isSeen, slopesOf, type Chunks } from "./chunks";
import type { Held, Lens } from "./held";

export const NEAR = 0.05;
const BLUR = 0.3; // square pixels added to each footprint, as in 3D Gaussian Splatting

/** Return the lens of a pose for pictures with `ratio` pixels to a CSS pixel. */
export function lensOf(pose: Pose, ratio: number): Lens {
  const rows = [...pose.right, ...pose.down, ...pose.ahead];
  const width = Math.max(1, Math.round(pose.width * ratio)), height = Math.max(1, Math.round(pose.height * ratio));
  return { eye: [...pose.eye], rows, focal: pose.focal * ratio, width, height };
}

/**
 * Rows of Gaussians that a lens sees, nearest first: all of them, or about `limit`, those that look most significant.
 *
 * A counting sort of 65,536 depths: linear in the number of Gaussians that are drawn.
 */
export class Sorter {
  private depth = new Float32Array(0);
  private seen = new Uint32Array(0);
  private order = new Uint32Array(0);
  private readonly starts = new Uint32Array(65537);
  ms = 0; // that the last order took

  sorted(held: Held, chunks: Chunks, lens: Lens, limit: number): Uint32Array {
    const begin = performance.now(), number = this.chosen(held, chunks, lens, limit), { depth, seen, order, starts } = this;
    let low = Infinity, high = -Infinity;
    for (let k = 0; k < number; k++) {
      if (depth[k] < low) low = depth[k];
      if (depth[k] > high) high = depth[k];
    }
    const scale = 65535 / Math.max(high - low, 1e-9);
    starts.fill(0);
    for (let k = 0; k < number; k++) starts[((depth[k] - low) * scale + 1) | 0]++;
    for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
    for (let k = 0; k < number; k++) order[starts[((depth[k] - low) * scale) | 0]++] = seen[k];
    this.ms = performance.now() - begin;
    return order.subarray(0, number);
  }

  private chosen(held: Held, chunks: Chunks, lens: Lens, limit: number): number {
    const seen = chunks.seen(lens), cut = limit < held.count ? chunks.cut(held, lens, seen, limit) : -Infinity;
    const { order, level, reach } = chunks, { centers } = held, [ex, ey, ez] = lens.eye, r = lens.rows, slopes = slopesOf(lens);
    let number = 0;
    this.make(Math.min(held.count, seen.length * (seen[0]?.end - seen[0]?.begin || 0)));
    for (const { begin, end, far } of seen) {
      const least = cut + far;
      for (let k = begin; k < end; k++) {
        const i = order[k];
        if (level[i] < least) break;
        if (!isSeen(held, i, lens, slopes, reach[i])) continue;
        this.depth[number] = (centers[3 * i] - ex) * r[6] + (centers[3 * i + 1] - ey) * r[7] + (centers[3 * i + 2] - ez) * r[8];
        this.seen[number++] = i;
      }
    }
    return number;
  }

  private make(room: number): void {
    if (this.depth.length >= room) return;
    this.depth = new Float32Array(room);
    this.seen = new Uint32Array(room);
    this.order = new Uint32Array(room);
  }
}

/** A Gaussian's footprint in a picture: its middle, covariance with blur, and opacity. */
export interface Footprint { x: number; y: number; xx: number; xy: number; yy: number; alpha: number }

/** Compute the footprint of row `i` in pixels; false where it is behind the camera. */
export function project(held: Held, i: number, lens: Lens, into: Footprint): boolean {
  const { centers, covariances } = held, [ex, ey, ez] = lens.eye, r = lens.rows, f = lens.focal;
  const X = centers[3 * i] - ex, Y = centers[3 * i + 1] - ey, Z = centers[3 * i + 2] - ez;
  const z = X * r[6] + Y * r[7] + Z * r[8];
  if (z < NEAR) return false;
  const px = (X * r[0] + Y * r[1] + Z * r[2]) / z, py = (X * r[3] + Y * r[4] + Z * r[5]) / z;
  const wide = (0.65 * lens.width) / f, tall = (0.65 * lens.height) / f, k = f / z;
  const cx = Math.min(wide, Math.max(-wide, px)), cy = Math.min(tall, Math.max(-tall, py));
  // rows of the Jacobian, in the scene's axes
  const ux = k * (r[0] - cx * r[6]), uy = k * (r[1] - cx * r[7]), uz = k * (r[2] - cx * r[8]);
  const vx = k * (r[3] - cy * r[6]), vy = k * (r[4] - cy * r[7]), vz = k * (r[5] - cy * r[8]);
  const c = 6 * i, a = covariances[c], b = covariances[c + 1], d = covariances[c + 2], e = covariances[c + 3], g = covariances[c + 4], h = covariances[c + 5];
  const sx = a * ux + b * uy + d * uz, sy = b * ux + e * uy + g * uz, sz = d * ux + g * uy + h * uz;
  const xx = ux * sx + uy * sy + uz * sz, xy = vx * sx + vy * sy + vz * sz;
  const yy = vx * (a * vx + b * vy + d * vz) + vy * (b * vx + e * vy + g * vz) + vz * (d * vx + g * vy + h * vz);
  into.x = lens.width / 2 + f * px;
  into.y = lens.height / 2 + f * py;
  into.xx = xx + BLUR;
  into.xy = xy;
  into.yy = yy + BLUR;
  into.alpha = held.rgba[4 * i + 3] / 255;
  if (held.antialiased) {
    const sharp = Math.max(0, (xx * yy - xy * xy) / (into.xx * into.yy - xy * xy));
    into.alpha *= Math.sqrt(Math.min(1, sharp));
  }
  return true;
}
