// Normal numbers from a counter: Philox 4x32 with ten rounds (Salmon et al., "Parallel random numbers: as easy as 1, 2,
// 3", 2011), and Box-Muller. What is drawn hangs on the seed and the place alone.
struct Four { u32 x[4]; };

DEVICE Four philox(u32 counter, u32 low, u32 high) {
  Four v = {{counter, 0, 0, 0}};
  for (int round = 0; round < 10; round++, low += 0x9e3779b9u, high += 0xbb67ae85u) {
    const u64 a = (u64)v.x[0] * 0xd2511f53u, b = (u64)v.x[2] * 0xcd9e8d57u;
    v = {{(u32)(b >> 32) ^ v.x[1] ^ low, (u32)b, (u32)(a >> 32) ^ v.x[3] ^ high, (u32)a}};
  }
  return v;
}

// Between 0 and 1, and neither.
DEVICE float open_unit(u32 bits) { return ((float)(bits >> 8) + 0.5f) * (1.f / 16777216); }

KERNEL draw_normals(float *out, u32 count, u32 low, u32 high) {
  const u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (4 * i >= count) return;
  const Four drawn = philox(i, low, high);
  for (u32 pair = 0; pair < 2; pair++) {
    const float length = sqrtf(-2.f * logf(open_unit(drawn.x[2 * pair])));
    const float angle = 6.2831853f * open_unit(drawn.x[2 * pair + 1]);
    const u32 at = 4 * i + 2 * pair;
    if (at < count) out[at] = length * cosf(angle);
    if (at + 1 < count) out[at + 1] = length * sinf(angle);
  }
}
