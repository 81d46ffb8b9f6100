// Vectors of three numbers, and the two directions of a floor.

export type Vec = [number, number, number];

export const dot = (a: Vec, b: Vec): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: Vec, b: Vec): Vec => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
/** Return a + s * b. */
export const plus = (a: Vec, b: Vec, s = 1): Vec => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
export const minus = (a: Vec, b: Vec): Vec => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (a: Vec, s: number): Vec => [a[0] * s, a[1] * s, a[2] * s];
export const mix = (a: Vec, b: Vec, t: number): Vec => plus(a, minus(b, a), t);
export const norm = (a: Vec): number => Math.hypot(a[0], a[1], a[2]);
export const unit = (a: Vec): Vec => times(a, 1 / (norm(a) || 1));
export const clamp = (x: number, low: number, high: number): number => Math.min(high, Math.max(low, x));

/** Return two unit directions that span the plane which `axis` is normal to. */
export function plane(axis: Vec): [Vec, Vec] {
  const first = unit(cross(Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], axis));
  return [first, cross(axis, first)];
}
