// A scene in Niantic's SPZ, version 3, as a page has it inside (github.com/nianticlabs/spz, README "File Format").

import { toHalf } from "./halves";
import type { Splats } from "./protocol";
import type { Vec } from "./vectors";

const MAGIC = 0x5053474e, HEADER = 16, COLOUR_SCALE = 0.15, MOST_VARIANCE = 6e4;
export const SH_C0 = 0.28209479177387814;

/** One Gaussian in the axes of the scene's own file. quat: x, y, z, w. sh: the constant harmonic. opacity: 0 to 255. */
export interface Row { center: Vec; quat: [number, number, number, number]; size: Vec; sh: Vec; opacity: number }

/** Rows of a decompressed SPZ; `read` fills one and the same row again and again. */
export interface Rows { count: number; read(i: number): Row }

export function rowsOf(buffer: ArrayBuffer): Rows {
  const view = new DataView(buffer), bytes = new Uint8Array(buffer), count = view.getUint32(8, true), fraction = 2 ** -bytes[13];
  if (view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== 3 || buffer.byteLength < HEADER + 20 * count) throw new Error("the scene in this page is damaged");
  const alphas = HEADER + 9 * count, colours = alphas + count, scales = colours + 3 * count, turns = scales + 3 * count;
  const row: Row = { center: [0, 0, 0], quat: [0, 0, 0, 0], size: [0, 0, 0], sh: [0, 0, 0], opacity: 0 }, flip = [1, -1, -1];
  return {
    count,
    read(i) {
      for (let k = 0; k < 3; k++) {
        const at = HEADER + 9 * i + 3 * k, raw = (bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16)) << 8 >> 8;
        row.center[k] = flip[k] * raw * fraction;
        row.sh[k] = (bytes[colours + 3 * i + k] / 255 - 0.5) / COLOUR_SCALE;
        row.size[k] = Math.exp(bytes[scales + 3 * i + k] / 16 - 10);
      }
      smallestThree(view.getUint32(turns + 4 * i, true), row.quat);
      row.opacity = bytes[alphas + i];
      return row;
    },
  };
}

/** Bring the rows of a decompressed SPZ into the browser's frame: scale * (x - center). */
export function splatsOf(buffer: ArrayBuffer, frame: { center: Vec; scale: number }): Splats {
  const { count, read } = rowsOf(buffer);
  const splats: Splats = { count, centers: new Float32Array(3 * count), covariances: new Uint16Array(6 * count), rgb: new Uint8Array(3 * count), opacity: new Uint8Array(count) };
  for (let i = 0; i < count; i++) {
    const { center, quat, size, sh, opacity } = read(i);
    for (let k = 0; k < 3; k++) {
      splats.centers[3 * i + k] = frame.scale * (center[k] - frame.center[k]);
      splats.rgb[3 * i + k] = Math.min(255, Math.max(0, Math.round(255 * (0.5 + SH_C0 * sh[k]))));
    }
    splats.opacity[i] = opacity;
    covariance(quat, size.map((s) => frame.scale * s), splats.covariances, 6 * i);
  }
  return splats;
}

/** Unpack (x, y, z, w): sign and 9 bits of the three smallest, the largest one's index on top; y and z turned back. */
function smallestThree(packed: number, into: number[]): void {
  const largest = packed >>> 30;
  let rest = packed, sum = 0;
  for (let k = 3; k >= 0; k--) {
    if (k === largest) continue;
    const size = (Math.SQRT1_2 * (rest & 511)) / 511;
    into[k] = (rest >>> 9) & 1 ? -size : size;
    sum += size * size;
    rest >>>= 10;
  }
  into[largest] = Math.sqrt(Math.max(0, 1 - sum));
  into[1] = -into[1];
  into[2] = -into[2];
}

function covariance([x, y, z, w]: number[], size: number[], into: Uint16Array, at: number): void {
  const R = [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
  const entry = (a: number, b: number) => size.reduce((sum, s, k) => sum + s * s * R[3 * a + k] * R[3 * b + k], 0);
  [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].forEach(([a, b], k) => {
    into[at + k] = toHalf(Math.max(-MOST_VARIANCE, Math.min(MOST_VARIANCE, entry(a, b))));
  });
}
