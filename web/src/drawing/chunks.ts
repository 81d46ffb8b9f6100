// Levels of detail: Gaussians that lie near each other make a chunk, the most significant of it first. What a picture
// has room for is chosen by how large a Gaussian looks: near chunks are drawn further down than far ones.

import type { Held, Lens } from "./held";

const ROWS = 1024; // of a chunk
const SIDE = 1024, REACH = 16; // cells along an axis, which end 16 units from the middle or, of a city, further: most lies within
const POWER = 0.3; // of the apparent size: volume to the power 0.1 is size to the power 0.3 (LightGaussian, Eq. 2)
const SAMPLES = 1 << 17, LEVELS = 4096, LOWEST = -32, STEP = 128; // of the histogram that finds the cut: 128 levels to a power of two
const SIGMAS = 3;

/** A chunk that a lens may see: its rows in `order`, and what its distance takes off the level of its rows. */
interface Seen { begin: number; end: number; far: number }

export class Chunks {
  private count = 0;
  order: Uint32Array = new Uint32Array(0); // rows, chunk by chunk
  level = new Float32Array(0); // log2 of opacity * volume^0.1, by row
  reach = new Float32Array(0); // how far a row is seen from its middle
  private middles = new Float32Array(0); // x, y, z, radius of all that is in a chunk, radius of its middles

  /** Take another scene, or more rows of it. Linear in its rows. */
  build(held: Held, opacity: Uint8Array): void {
    this.count = held.count;
    this.level = new Float32Array(held.count);
    this.reach = new Float32Array(held.count);
    this.measure(held, opacity, held.count);
    const near = inCells(held), chunk = new Uint16Array(held.count), count = Math.ceil(held.count / ROWS);
    for (let k = 0; k < near.length; k++) chunk[near[k]] = Math.floor(k / ROWS);
    const falling = sortedBy(near.length, (i) => Math.max(0, Math.min(65535, Math.round(65535 - (this.level[i] - LOWEST) * 1800))));
    const next = Uint32Array.from({ length: count }, (_, c) => c * ROWS);
    this.order = near; // all of it is written anew
    for (const i of falling) this.order[next[chunk[i]]++] = i;
    this.bound(held);
  }

  /** Take other places and shapes of the first rows: chunks keep their rows, and reach as far as these now lie. */
  move(held: Held, upto: number): void {
    this.measure(held, null, upto);
    this.bound(held);
  }

  private measure({ covariances: S }: Held, opacity: Uint8Array | null, upto: number): void {
    for (let i = 0, c = 0; i < upto; i++, c += 6) {
      const a = S[c], b = S[c + 1], d = S[c + 2], e = S[c + 3], g = S[c + 4], h = S[c + 5], middle = (a + e + h) / 3;
      this.reach[i] = SIGMAS * Math.sqrt(3 * middle);
      if (!opacity) continue;
      const volume2 = Math.max(a * (e * h - g * g) - b * (b * h - g * d) + d * (b * g - e * d), 1e-6 * middle ** 3, 1e-30); // flat ones lose theirs to 16 bits
      this.level[i] = Math.log2((opacity[i] + 0.5) / 255) + 0.05 * Math.log2(volume2);
    }
  }

  private bound({ centers }: Held): void {
    const count = Math.ceil(this.count / ROWS), middles = this.middles = new Float32Array(5 * count);
    for (let c = 0; c < count; c++) {
      const begin = c * ROWS, end = Math.min(begin + ROWS, this.count), sum = [0, 0, 0];
      for (let k = begin; k < end; k++) for (let x = 0; x < 3; x++) sum[x] += centers[3 * this.order[k] + x];
      const [x, y, z] = sum.map((one) => one / (end - begin));
      let widest = 0, squares = 0;
      for (let k = begin; k < end; k++) {
        const i = this.order[k], away2 = (centers[3 * i] - x) ** 2 + (centers[3 * i + 1] - y) ** 2 + (centers[3 * i + 2] - z) ** 2;
        widest = Math.max(widest, Math.sqrt(away2) + this.reach[i]);
        squares += away2;
      }
      middles.set([x, y, z, widest, Math.sqrt(squares / (end - begin))], 5 * c);
    }
  }

  /** Return the chunks that a lens may see. */
  seen(lens: Lens): Seen[] {
    const made: Seen[] = [], { middles } = this, [ex, ey, ez] = lens.eye, r = lens.rows, slopes = slopesOf(lens);
    for (let c = 0, m = 0; m < middles.length; c++, m += 5) {
      const x = middles[m] - ex, y = middles[m + 1] - ey, z = middles[m + 2] - ez, radius = middles[m + 3];
      const right = x * r[0] + y * r[1] + z * r[2], down = x * r[3] + y * r[4] + z * r[5], ahead = x * r[6] + y * r[7] + z * r[8];
      if (ahead + radius < 0 || isOutside(right, down, ahead, radius, slopes)) continue;
      const far = POWER * Math.log2(Math.max(Math.sqrt(x * x + y * y + z * z), middles[m + 4], 1e-6));
      made.push({ begin: c * ROWS, end: Math.min((c + 1) * ROWS, this.count), far });
    }
    return made;
  }

  /** Return the least level (with its chunk's `far` taken off) of about as many rows as there is room for; a sample finds it. */
  cut(held: Held, lens: Lens, seen: Seen[], room: number): number {
    const step = Math.max(1, Math.floor(this.count / SAMPLES)), counts = new Uint32Array(LEVELS), slopes = slopesOf(lens);
    let number = 0;
    for (const { begin, end, far } of seen) {
      for (let k = begin + ((begin * 7) % step); k < end; k += step) {
        const i = this.order[k];
        if (!isSeen(held, i, lens, slopes, this.reach[i])) continue;
        counts[Math.max(0, Math.min(LEVELS - 1, Math.floor((this.level[i] - far - LOWEST) * STEP)))]++;
        number++;
      }
    }
    if (number * step <= room) return -Infinity;
    let left = room / step, at = LEVELS;
    while (at > 0 && left >= counts[at - 1]) left -= counts[--at];
    return LOWEST + at / STEP;
  }
}

/** How fast a picture's sides run apart, and how much longer a way to a side is than along its axis. */
export interface Slopes { wide: number; tall: number; wider: number; taller: number }

export function slopesOf({ width, height, focal }: Lens): Slopes {
  const wide = width / (2 * focal), tall = height / (2 * focal);
  return { wide, tall, wider: Math.sqrt(1 + wide * wide), taller: Math.sqrt(1 + tall * tall) };
}

function isOutside(right: number, down: number, ahead: number, radius: number, { wide, tall, wider, taller }: Slopes): boolean {
  return Math.abs(right) > wide * ahead + radius * wider || Math.abs(down) > tall * ahead + radius * taller;
}

/** Return whether some of a row may be seen: blur is two pixels at most, and a tenth of a picture is let in at its sides. */
export function isSeen({ centers, rgba }: Held, i: number, lens: Lens, slopes: Slopes, reach: number): boolean {
  if (rgba[4 * i + 3] === 0) return false;
  const r = lens.rows, x = centers[3 * i] - lens.eye[0], y = centers[3 * i + 1] - lens.eye[1], z = centers[3 * i + 2] - lens.eye[2];
  const ahead = x * r[6] + y * r[7] + z * r[8];
  if (ahead < 0.05) return false;
  const radius = reach + 0.1 * slopes.wide * ahead;
  return !isOutside(x * r[0] + y * r[1] + z * r[2], x * r[3] + y * r[4] + z * r[5], ahead, radius, slopes);
}

/** Return the rows along a Morton curve. */
function inCells({ count, centers }: Held): Uint32Array {
  const reach = reachOf(count, centers), code = new Uint32Array(count), cell = (x: number) => Math.max(0, Math.min(SIDE - 1, Math.floor(((x + reach) * SIDE) / (2 * reach)))) || 0;
  for (let i = 0; i < count; i++) code[i] = spread(cell(centers[3 * i])) | (spread(cell(centers[3 * i + 1])) << 1) | (spread(cell(centers[3 * i + 2])) << 2);
  const low = sortedBy(count, (i) => code[i] & 0x7fff);
  return sortedBy(count, (i) => code[i] >>> 15, low);
}

/** Return how far cells reach: 16 units, or, of a city, as far as nearly all of a sample. */
function reachOf(count: number, centers: Float32Array): number {
  const step = Math.max(1, Math.floor(count / 4096)), far: number[] = [];
  for (let i = 0; i < count; i += step) far.push(Math.max(Math.abs(centers[3 * i]), Math.abs(centers[3 * i + 1]), Math.abs(centers[3 * i + 2])));
  far.sort((a, b) => a - b);
  return Math.max(REACH, 1.1 * (far[Math.floor(0.95 * (far.length - 1))] || 0));
}

/** Put two zeros after each of ten bits. */
function spread(bits: number): number {
  let x = bits;
  x = (x | (x << 16)) & 0x030000ff;
  x = (x | (x << 8)) & 0x0300f00f;
  x = (x | (x << 4)) & 0x030c30c3;
  return (x | (x << 2)) & 0x09249249;
}

/** Return rows by a key of 16 bits; rows of one key stay in the order in which they come. */
function sortedBy(count: number, key: (row: number) => number, rows: Uint32Array | null = null): Uint32Array {
  const starts = new Uint32Array(65537), out = new Uint32Array(count);
  for (let i = 0; i < count; i++) starts[key(i) + 1]++;
  for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
  for (let k = 0; k < count; k++) { const i = rows ? rows[k] : k; out[starts[key(i)]++] = i; }
  return out;
}
