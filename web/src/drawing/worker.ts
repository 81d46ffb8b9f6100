// Beside the page's thread: sorts for a graphics card, or draws where there is none.

import { HALVES } from "../halves";
import { Chunks } from "./chunks";
import { Raster, type Marks } from "./raster";
import type { Held, Lens } from "./held";
import { Sorter } from "./project";

/** Rows of a scene of `room`, from a row on: the first of them replace the scene before. */
export interface Rows { room: number; from: number; centers: Float32Array; covariances: Uint16Array; opacity: Uint8Array }

export type Order =
  | { do: "hold"; rows: Rows; antialiased: boolean }
  | { do: "move"; centers: Float32Array; covariances: Uint16Array } // of the first rows
  | { do: "paint"; rgba: Uint8Array }
  | { do: "mark"; marks: Marks[] }
  | { do: "sort"; lens: Lens; limit: number }
  | { do: "draw"; lens: Lens; limit: number; background: number[] };

export type Reply =
  | { done: "sort"; rows: Uint32Array; sorted: number } // sorted: milliseconds
  | { done: "draw"; picture: Uint8ClampedArray<ArrayBuffer>; lens: Lens; ms: number; sorted: number };

const scope = self as unknown as { onmessage: (event: MessageEvent<Order>) => void; postMessage(message: Reply, transfer: Transferable[]): void };
const sorter = new Sorter(), raster = new Raster(), chunks = new Chunks();
let held: Held | null = null, opacity = new Uint8Array(0), marks: Marks[] = [];

let latest = 0; // number of the newest order to draw: older ones are given up

/** Let orders in that have come meanwhile; a timer would wait for milliseconds. */
const channel = new MessageChannel();
let waiting: (() => void) | null = null;
channel.port1.onmessage = () => waiting?.();
const pause = () => new Promise<void>((done) => { waiting = done; channel.port2.postMessage(null); });

async function draw(held: Held, { lens, limit, background }: Extract<Order, { do: "draw" }>): Promise<void> {
  const begin = performance.now(), own = ++latest, steps = raster.draw(held, chunks, lens, background, limit);
  let step = steps.next();
  for (; !step.done; step = steps.next()) {
    await pause();
    if (own !== latest) return;
  }
  raster.outline(step.value, held, lens, marks, Math.max(1, Math.round(lens.height / 350)));
  scope.postMessage({ done: "draw", picture: step.value, lens, ms: performance.now() - begin, sorted: raster.sorter.ms }, [step.value.buffer]);
}

/** Take rows that follow those that are there. */
function grown(rows: Rows, antialiased: boolean): Held {
  const { room, from } = rows, count = from + rows.opacity.length;
  if (!held || from === 0) {
    held = { count, centers: new Float32Array(3 * room), covariances: new Float32Array(6 * room), rgba: new Uint8Array(4 * room).fill(255), antialiased };
    opacity = new Uint8Array(room);
  }
  held.count = count;
  held.centers.set(rows.centers, 3 * from);
  unpack(rows.covariances, held.covariances, 6 * from);
  opacity.set(rows.opacity, from);
  chunks.build(held, opacity);
  return held;
}

function unpack(halves: Uint16Array, into: Float32Array, at: number): void {
  for (let i = 0; i < halves.length; i++) into[at + i] = HALVES[halves[i]];
}

scope.onmessage = ({ data: order }) => {
  if (order.do === "hold") held = grown(order.rows, order.antialiased);
  else if (order.do === "mark") marks = order.marks;
  else if (!held) return;
  else if (order.do === "move") {
    held.centers.set(order.centers);
    unpack(order.covariances, held.covariances, 0);
    chunks.move(held, order.centers.length / 3);
  } else if (order.do === "paint") held.rgba = order.rgba;
  else if (order.do === "sort") {
    const rows = sorter.sorted(held, chunks, order.lens, order.limit).slice().reverse(); // a card blends back to front
    scope.postMessage({ done: "sort", rows, sorted: sorter.ms }, [rows.buffer]);
  } else void draw(held, order);
};
