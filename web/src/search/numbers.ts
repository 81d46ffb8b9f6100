// Order statistics and clusters of points: plain functions of arrays.

/** Return the `rank`-th largest value, counted from 1, or the lowest of fewer. */
export function largest(values: Float32Array, rank: number): number {
  const left = values.slice(), at = Math.max(0, left.length - rank);
  let low = 0, high = left.length - 1;
  while (low < high) {
    const pivot = left[(low + high) >> 1];
    let i = low, j = high;
    while (i <= j) {
      while (left[i] < pivot) i++;
      while (left[j] > pivot) j--;
      if (i <= j) { const held = left[i]; left[i++] = left[j]; left[j--] = held; }
    }
    if (at <= j) high = j;
    else if (at >= i) low = i;
    else break;
  }
  return left[at];
}

export const most = (values: ArrayLike<number>): number => { let top = -Infinity; for (let i = 0; i < values.length; i++) if (values[i] > top) top = values[i]; return top; };

/** Return the mean of the two middle values, or the middle one. */
export function median(values: Float32Array): number { return (largest(values, (values.length >> 1) + 1) + largest(values, (values.length + 1) >> 1)) / 2; }

/** Round as Python does: halves to the even number. */
export function rounded(x: number): number {
  const low = Math.floor(x), half = x - low;
  return half < 0.5 || (half === 0.5 && low % 2 === 0) ? low : low + 1;
}

/** Sets that are joined pair by pair. */
export class Sets {
  private readonly above: Int32Array;
  constructor(count: number) { this.above = Int32Array.from({ length: count }, (_, i) => i); }

  of(i: number): number {
    while (this.above[i] !== i) { this.above[i] = this.above[this.above[i]]; i = this.above[i]; }
    return i;
  }

  join(a: number, b: number): void {
    const one = this.of(a), other = this.of(b);
    this.above[Math.max(one, other)] = Math.min(one, other);
  }
}

const LEAF = 12;

/** Points in space that are asked for their neighbours. `at`: x, y, z of each. */
export class Tree {
  private readonly order: Uint32Array;
  private readonly splits: Float64Array;
  private readonly sides: Uint8Array;
  private readonly here = new Float64Array(3);
  squares = new Float64Array(0);
  rows = new Int32Array(0);

  constructor(readonly at: Float64Array) {
    const count = at.length / 3;
    this.order = Uint32Array.from({ length: count }, (_, i) => i);
    this.splits = new Float64Array(2 * Math.max(1, count) + 1);
    this.sides = new Uint8Array(this.splits.length);
    this.split(0, count, 1);
  }

  private split(begin: number, end: number, node: number): void {
    if (end - begin <= LEAF || node >= this.sides.length) return;
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], { at, order } = this;
    for (let i = begin; i < end; i++) for (let k = 0; k < 3; k++) { const x = at[3 * order[i] + k]; if (x < low[k]) low[k] = x; if (x > high[k]) high[k] = x; }
    let side = 0;
    for (let k = 1; k < 3; k++) if (high[k] - low[k] > high[side] - low[side]) side = k;
    const middle = begin + ((end - begin) >> 1);
    this.halve(begin, end - 1, middle, side);
    this.splits[node] = at[3 * order[middle] + side];
    this.sides[node] = side;
    this.split(begin, middle, 2 * node);
    this.split(middle, end, 2 * node + 1);
  }

  /** Bring the points that are lower than that of a place in the order before it, the others behind it. */
  private halve(low: number, high: number, place: number, side: number): void {
    const { at, order } = this;
    while (low < high) {
      const pivot = at[3 * order[(low + high) >> 1] + side];
      let i = low, j = high;
      while (i <= j) {
        while (at[3 * order[i] + side] < pivot) i++;
        while (at[3 * order[j] + side] > pivot) j--;
        if (i <= j) { const held = order[i]; order[i++] = order[j]; order[j--] = held; }
      }
      if (place <= j) high = j;
      else if (place >= i) low = i;
      else return;
    }
  }

  /** Return the squares of the `count` smallest distances from a place, ascending, and whose they are; both are written
   * anew by the next call. */
  nearest(x: number, y: number, z: number, count: number): { squares: Float64Array; rows: Int32Array } {
    if (this.squares.length !== count) [this.squares, this.rows] = [new Float64Array(count), new Int32Array(count)];
    this.squares.fill(Infinity);
    this.rows.fill(-1);
    this.here[0] = x;
    this.here[1] = y;
    this.here[2] = z;
    this.look(0, this.order.length, 1);
    return this;
  }

  private look(begin: number, end: number, node: number): void {
    const { here, squares, rows, at, order } = this, last = squares.length - 1;
    if (end - begin <= LEAF || node >= this.sides.length) {
      for (let i = begin; i < end; i++) {
        const row = order[i], dx = at[3 * row] - here[0], dy = at[3 * row + 1] - here[1], dz = at[3 * row + 2] - here[2], square = dx * dx + dy * dy + dz * dz;
        let k = last;
        if (square >= squares[k]) continue;
        for (; k > 0 && squares[k - 1] > square; k--) { squares[k] = squares[k - 1]; rows[k] = rows[k - 1]; }
        squares[k] = square;
        rows[k] = row;
      }
      return;
    }
    const gap = here[this.sides[node]] - this.splits[node], middle = begin + ((end - begin) >> 1);
    if (gap < 0) this.look(begin, middle, 2 * node);
    if (gap >= 0 || gap * gap <= squares[last]) this.look(middle, end, 2 * node + 1);
    if (gap >= 0 && gap * gap <= squares[last]) this.look(begin, middle, 2 * node);
  }
}

/** Return for each point a number of those that steps of at most `reach` lead to. */
export function connected(at: Float64Array, reach: number): Int32Array {
  const count = at.length / 3, sets = new Sets(count), side = reach / Math.sqrt(3) || 1, cells = new Map<string, number[]>(), cell = (i: number, k: number) => Math.floor(at[3 * i + k] / side);
  for (let i = 0; i < count; i++) {
    const key = `${cell(i, 0)},${cell(i, 1)},${cell(i, 2)}`, held = cells.get(key);
    if (held) { sets.join(held[0], i); held.push(i); } else cells.set(key, [i]);
  }
  const far = reach * reach;
  for (const held of cells.values()) {
    const [a, b, c] = [0, 1, 2].map((k) => cell(held[0], k));
    for (let dx = 0; dx <= 2; dx++) for (let dy = dx ? -2 : 0; dy <= 2; dy++) for (let dz = dx || dy ? -2 : 1; dz <= 2; dz++) {
      const others = cells.get(`${a + dx},${b + dy},${c + dz}`);
      if (others && sets.of(held[0]) !== sets.of(others[0]) && within(at, held, others, far)) sets.join(held[0], others[0]);
    }
  }
  return Int32Array.from({ length: count }, (_, i) => sets.of(i));
}

function within(at: Float64Array, some: number[], others: number[], far: number): boolean {
  return some.some((i) => others.some((j) => (at[3 * i] - at[3 * j]) ** 2 + (at[3 * i + 1] - at[3 * j + 1]) ** 2 + (at[3 * i + 2] - at[3 * j + 2]) ** 2 <= far));
}
