// Features of the shown Gaussians as sums of centroids, a byte for each stage; see fronts/viewing/page_search.py.

export class Codes {
  readonly count: number;
  private readonly codes: Uint8Array[];
  private readonly tables: Float32Array[]; // of each stage: 256 centroids

  /** rows: the shown Gaussians that have a feature. codes: of each stage, per shown Gaussian. */
  constructor(readonly rows: Uint32Array, codes: Uint8Array[], centroids: Uint8Array, steps: Float32Array, readonly dim: number) {
    this.count = rows.length;
    this.codes = codes.map((stage) => Uint8Array.from(rows, (row) => stage[row]));
    this.tables = codes.map((_, k) => Float32Array.from(centroids.subarray(256 * dim * k, 256 * dim * (k + 1)), (x) => (x - 128) * steps[k]));
  }

  /** Return the inner products of a vector with all centroids, stage by stage. */
  products(query: Float32Array): Float32Array[] {
    return this.tables.map((table) => {
      const out = new Float32Array(256);
      for (let c = 0; c < 256; c++) {
        let sum = 0;
        for (let d = 0, at = c * this.dim; d < this.dim; d++, at++) sum += table[at] * query[d];
        out[c] = sum;
      }
      return out;
    });
  }

  /** Return the inner product of a vector with each row's feature. */
  scores(query: Float32Array): Float32Array {
    const out = new Float32Array(this.count);
    this.products(query).forEach((table, k) => { const codes = this.codes[k]; for (let i = 0; i < out.length; i++) out[i] += table[codes[i]]; });
    return out;
  }

  /** Return the row numbers of each centroid of the first stage: rows that are roughly alike. */
  alike(): Uint32Array[] {
    const sizes = new Uint32Array(256), first = this.codes[0];
    for (const code of first) sizes[code]++;
    const groups = Array.from(sizes, (size) => new Uint32Array(size)), at = new Uint32Array(256);
    first.forEach((code, i) => { groups[code][at[code]++] = i; });
    return groups;
  }

  /** Return a row's feature. */
  feature(row: number): Float32Array {
    const out = new Float32Array(this.dim);
    this.tables.forEach((table, k) => { for (let d = 0, at = this.codes[k][row] * this.dim; d < this.dim; d++, at++) out[d] += table[at]; });
    return out;
  }

  /** Return a row's inner product with a vector of which `products` is known. */
  score(row: number, products: Float32Array[]): number {
    let sum = 0;
    for (let k = 0; k < products.length; k++) sum += products[k][this.codes[k][row]];
    return sum;
  }
}

export function product(a: Float32Array, b: Float32Array): number {
  let sum = 0;
  for (let d = 0; d < a.length; d++) sum += a[d] * b[d];
  return sum;
}
