// What a ray through a pixel meets, in a page that has nobody to ask.

import { fromHalf } from "./halves";
import type { Splats } from "./protocol";
import { dot, plane, type Vec } from "./vectors";

/** Return the row with the largest blending weight along a ray, -1 where it meets nothing. */
export function pick(splats: Splats, eye: Vec, direction: Vec): number {
  const met: [number, number, number][] = [], { centers, covariances, opacity } = splats;
  for (let i = 0; i < splats.count; i++) {
    const p: Vec = [centers[3 * i] - eye[0], centers[3 * i + 1] - eye[1], centers[3 * i + 2] - eye[2]], z = dot(p, direction);
    if (z <= 0) continue;
    const c = 6 * i, widest = fromHalf(covariances[c]) + fromHalf(covariances[c + 3]) + fromHalf(covariances[c + 5]);
    if (dot(p, p) - z * z > 9 * widest) continue;
    const alpha = (opacity[i] / 255) * Math.exp(-0.5 * distance2(p, direction, covariances, c));
    if (alpha > 1 / 255) met.push([z, Math.min(0.99, alpha), i]);
  }
  met.sort((a, b) => a[0] - b[0]);
  let left = 1, best = -1, heaviest = 0;
  for (const [, alpha, i] of met) {
    if (left * alpha > heaviest) { best = i; heaviest = left * alpha; }
    left *= 1 - alpha;
  }
  return best;
}

/** Return the least squared Mahalanobis distance along a ray, of the covariance as seen along it. */
function distance2(p: Vec, direction: Vec, covariances: Uint16Array, c: number): number {
  const [e, n] = plane(direction), S = [0, 1, 2, 3, 4, 5].map((k) => fromHalf(covariances[c + k]));
  const times = (v: Vec): Vec => [S[0] * v[0] + S[1] * v[1] + S[2] * v[2], S[1] * v[0] + S[3] * v[1] + S[4] * v[2], S[2] * v[0] + S[4] * v[1] + S[5] * v[2]];
  const se = times(e), sn = times(n), a = dot(e, se) + 1e-7, b = dot(e, sn), g = dot(n, sn) + 1e-7, u = dot(p, e), v = dot(p, n), det = a * g - b * b;
  return det > 0 ? (g * u * u - 2 * b * u * v + a * v * v) / det : Infinity;
}
