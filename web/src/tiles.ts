// A scene in tiles: all of it coarsely, then wholly what the camera is near to, as far as there is room.

import type { Camera } from "./camera";
import type { Live, Paint, Splats, TiledScene } from "./protocol";
import { clamp, dot, minus, norm, type Vec } from "./vectors";

const FIRST_PARTS = 4, MOST_PARTS = 16, MOST_ROWS = 1 << 18; // of a request
const GROWN = 1.5; // times as many rows as are shown, before more are shown while others still come
const BEHIND = 4; // a tile behind the camera counts as so many times as far
const KEPT = 0.7; // a tile that is here counts as so much nearer, so that two of them do not take turns

/** Rows of a part as they came, and what they answer; null until that is asked. */
interface Part { splats: Splats; paint: Paint | null; colors: Uint8Array | null }

export interface Shown { splats: Splats; paint: Paint; colors: Uint8Array | null }

export class TileSet {
  private readonly parts = new Map<number, Part>(); // 2 k: tile k coarsely; 2 k + 1: what that leaves out
  private shown = 0;
  private running = false;
  private again = false;
  private painted = 0; // of the paint that is wanted

  constructor(private readonly live: Live, private readonly scene: TiledScene,
    private readonly camera: Camera, private readonly show: (shown: Shown, isWhole: boolean) => void, private readonly whole: () => void, private readonly fail: (error: unknown) => void) {}

  get count(): number { return Array.from(this.parts.values(), ({ splats }) => splats.count).reduce((sum, one) => sum + one, 0); }

  /** How many tiles are here wholly. */
  get numWhole(): number { return Array.from(this.parts.keys()).filter((part) => part % 2).length; }

  private rows(part: number): number {
    const { coarse, rows } = this.scene.tiles[part >> 1];
    return part % 2 ? rows - coarse : coarse;
  }

  /** Return the parts that should be here, the most wanted first: coarse ones of all, then the rest of near tiles. */
  wanted(): number[] {
    const eye = this.camera.eye, ahead = minus(this.camera.target, eye), away = this.scene.tiles.map(({ low, high }, tile) => {
      const nearest = low.map((x, k) => clamp(eye[k], x, high[k])) as Vec, way = minus(nearest, eye), middle = low.map((x, k) => (x + high[k]) / 2 - eye[k]) as Vec;
      const distance = norm(way) * (dot(middle, ahead) < 0 && norm(way) > 0 ? BEHIND : 1);
      return distance * (this.parts.has(2 * tile + 1) ? KEPT : 1);
    });
    const order = Array.from(away.keys()).sort((a, b) => away[a] - away[b]), wanted = order.map((tile) => 2 * tile);
    let left = Math.min(this.scene.budget, this.live.room) - wanted.reduce((sum, part) => sum + this.rows(part), 0);
    for (const tile of order) {
      const part = 2 * tile + 1, rows = this.rows(part);
      if (rows > left) break;
      if (rows) wanted.push(part);
      left -= rows;
    }
    return wanted;
  }

  /** Fetch what the camera needs and is not here; called again meanwhile, begin anew with the next request. */
  async stream(): Promise<void> {
    this.again = true;
    if (this.running) return;
    this.running = true;
    try {
      while (this.again) {
        this.again = false;
        await this.fetch();
      }
    } catch (error) {
      this.fail(error);
    } finally {
      this.running = false;
    }
  }

  private async fetch(): Promise<void> {
    for (let changed = true; ;) {
      const wanted = this.wanted(), kept = new Set(wanted);
      for (const part of this.parts.keys()) if (!kept.has(part)) { this.parts.delete(part); changed = true; }
      const missing = batch(wanted.filter((part) => !this.parts.has(part)), (part) => this.rows(part), this.parts.size ? MOST_PARTS : FIRST_PARTS);
      if (!missing.length) {
        if (changed) await this.present(true);
        else this.whole();
        return;
      }
      const splats = await this.live.tiles(missing);
      let at = 0;
      for (const part of missing) { this.parts.set(part, { splats: cut(splats, at, this.rows(part)), paint: null, colors: null }); at += this.rows(part); }
      changed = true;
      if (this.count >= GROWN * this.shown) await this.present(false);
    }
  }

  /** Ask anew what all rows answer. */
  async repaint(): Promise<void> {
    for (const part of this.parts.values()) part.paint = part.colors = null;
    await this.present(!this.running);
  }

  private async present(isWhole: boolean): Promise<void> {
    const own = ++this.painted;
    for (let some; (some = batch(Array.from(this.parts.keys()).filter((part) => !this.parts.get(part)?.paint), (part) => this.rows(part))).length;) {
      const { paint, colors } = await this.live.tilesPaint(some);
      let at = 0;
      for (const part of some) {
        const rows = this.rows(part), here = this.parts.get(part);
        if (here) Object.assign(here, { paint: cutPaint(paint, at, rows), colors: colors?.slice(3 * at, 3 * (at + rows)) ?? null });
        at += rows;
      }
      if (own !== this.painted) return; // what was asked meanwhile shows these too
    }
    const all = Array.from(this.parts.values());
    this.shown = this.count;
    this.show({ splats: joined(all.map((one) => one.splats)), paint: joinedPaint(all.map((one) => one.paint as Paint)), colors: all.every((one) => one.colors) ? bytes(all.map((one) => one.colors as Uint8Array)) : null }, isWhole);
  }
}

/** Return as many parts as one request may ask for; one at least, if there is any. */
function batch(parts: number[], rows: (part: number) => number, most = MOST_PARTS): number[] {
  let sum = 0, count = 0;
  while (count < Math.min(parts.length, most) && (!count || sum + rows(parts[count]) <= MOST_ROWS)) sum += rows(parts[count++]);
  return parts.slice(0, count);
}

function cut({ centers, covariances, rgb, opacity }: Splats, at: number, count: number): Splats {
  const end = at + count;
  return { count, centers: centers.slice(3 * at, 3 * end), covariances: covariances.slice(6 * at, 6 * end), rgb: rgb.slice(3 * at, 3 * end), opacity: opacity.slice(at, end) };
}

function cutPaint({ heat, owner, object }: Paint, at: number, count: number): Paint {
  return { heat: heat.slice(at, at + count), owner: owner.slice(at, at + count), object: object?.slice(at, at + count) ?? null };
}

function joined(all: Splats[]): Splats {
  const count = all.reduce((sum, one) => sum + one.count, 0);
  const made: Splats = { count, centers: new Float32Array(3 * count), covariances: new Uint16Array(6 * count), rgb: new Uint8Array(3 * count), opacity: new Uint8Array(count) };
  let at = 0;
  for (const one of all) {
    made.centers.set(one.centers, 3 * at);
    made.covariances.set(one.covariances, 6 * at);
    made.rgb.set(one.rgb, 3 * at);
    made.opacity.set(one.opacity, at);
    at += one.count;
  }
  return made;
}

function joinedPaint(all: Paint[]): Paint {
  const objects = all.map((one) => one.object), count = all.reduce((sum, one) => sum + one.heat.length, 0), object = objects.every((one) => one) && all.length ? new Uint16Array(count) : null;
  let at = 0;
  if (object) for (const one of objects) { object.set(one as Uint16Array, at); at += (one as Uint16Array).length; }
  return { heat: bytes(all.map((one) => one.heat)), owner: bytes(all.map((one) => one.owner)), object };
}

function bytes(all: Uint8Array[]): Uint8Array {
  const made = new Uint8Array(all.reduce((sum, one) => sum + one.length, 0));
  let at = 0;
  for (const one of all) { made.set(one, at); at += one.length; }
  return made;
}
