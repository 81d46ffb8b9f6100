// Numbers of 16 bits, as covariances are kept.

const real = new Float32Array(1), bits = new Uint32Array(real.buffer);

/** Return the number that 16 bits mean. */
export function fromHalf(h: number): number {
  const exponent = (h >> 10) & 31, fraction = h & 1023, sign = h & 32768 ? -1 : 1;
  return sign * (exponent === 0 ? fraction * 2 ** -24 : 2 ** (exponent - 15) * (1 + fraction / 1024));
}

/** Return the 16 bits of the nearest number that they can mean; what is too large becomes the largest. */
export function toHalf(x: number): number {
  const sign = x < 0 ? 0x8000 : 0, size = Math.abs(x);
  if (size < 2 ** -14) return sign | Math.round(size * 2 ** 24);
  real[0] = size;
  return sign | Math.min(0x7bff, (bits[0] - 0x38000000 + 0x1000) >>> 13);
}

/** What all of them mean. */
export const HALVES = Float32Array.from({ length: 65536 }, (_, h) => fromHalf(h));
