// A CRC is the remainder of a polynomial over the numbers 0 and 1. Sixteen bytes are replaced by their product with a
// power of x, modulo the divisor, which is added to bytes that lie further on: the remainder stays the same.
// Source: Gopal et al. 2009, Fast CRC computation for generic polynomials using PCLMULQDQ.
#include "host/checksum.h"

#include "host/parallel.h"
#include "host/processor.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace drsplat {
namespace {

constexpr uint32_t kDivisor = 0xedb88320;  // of zlib and PNG, its lowest power in the highest bit

constexpr size_t kPart = 4 << 20;  // bytes that are worth a thread

constexpr uint32_t times_x(uint32_t value) { return value >> 1 ^ (value & 1 ? kDivisor : 0); }

// Of two polynomials, modulo the divisor.
uint32_t product(uint32_t a, uint32_t b) {
  uint32_t sum = 0;
  for (; a; a <<= 1, b = times_x(b))
    if (a >> 31) sum ^= b;
  return sum;
}

// What a checksum is worth so many bytes further on.
uint32_t moved_on(uint32_t value, size_t count) {
  for (uint32_t power = 1u << 23; count; count >>= 1, power = product(power, power))  // x^8, x^16, x^32 ...
    if (count & 1) value = product(value, power);
  return value;
}

// What each byte is worth, and what it is with up to seven bytes after it.
struct Tables {
  uint32_t of[8][256];
  Tables() {
    for (uint32_t byte = 0; byte < 256; byte++) {
      of[0][byte] = byte;
      for (int bit = 0; bit < 8; bit++) of[0][byte] = times_x(of[0][byte]);
    }
    for (int after = 1; after < 8; after++)
      for (int byte = 0; byte < 256; byte++) {
        const uint32_t before = of[after - 1][byte];
        of[after][byte] = of[0][before & 255] ^ before >> 8;
      }
  }
};

uint32_t by_tables(const uint8_t *bytes, size_t count, uint32_t state) {
  static const Tables tables;
  const auto &of = tables.of;
  for (; count >= 8; bytes += 8, count -= 8) {
    for (int i = 0; i < 4; i++) state ^= (uint32_t)bytes[i] << 8 * i;
    uint32_t next = of[3][bytes[4]] ^ of[2][bytes[5]] ^ of[1][bytes[6]] ^ of[0][bytes[7]];
    for (int i = 0; i < 4; i++) next ^= of[7 - i][state >> 8 * i & 255];
    state = next;
  }
  for (size_t i = 0; i < count; i++) state = of[0][(state ^ bytes[i]) & 255] ^ state >> 8;
  return state;
}

#if defined(__x86_64__)
constexpr size_t kLane = 16, kLanes = 4, kStride = kLane * kLanes;

// x to a power, modulo the divisor, as a factor of products that are one bit too low.
constexpr int64_t factor(int power) {
  uint32_t value = 0x80000000;
  for (int i = 0; i < power; i++) value = times_x(value);
  return (int64_t)((uint64_t)value << 1);
}

#define CARRYLESS __attribute__((target("sse4.2,pclmul")))

// What `lane` is worth so many bytes further on.
template <size_t Further>
CARRYLESS inline __m128i moved(__m128i lane) {
  constexpr int64_t low = factor(8 * (int)Further + 32), high = factor(8 * (int)Further - 32);
  const __m128i factors = _mm_set_epi64x(high, low);
  return _mm_xor_si128(_mm_clmulepi64_si128(lane, factors, 0x00), _mm_clmulepi64_si128(lane, factors, 0x11));
}

CARRYLESS inline __m128i loaded(const uint8_t *at) { return _mm_loadu_si128((const __m128i *)at); }

// Of whole strides, one at least.
CARRYLESS uint32_t by_strides(const uint8_t *bytes, size_t strides, uint32_t state) {
  __m128i lanes[kLanes];
  for (size_t l = 0; l < kLanes; l++) lanes[l] = loaded(bytes + kLane * l);
  lanes[0] = _mm_xor_si128(lanes[0], _mm_cvtsi32_si128((int)state));
  for (size_t s = 1; s < strides; s++) {
    bytes += kStride;
    for (size_t l = 0; l < kLanes; l++) lanes[l] = _mm_xor_si128(moved<kStride>(lanes[l]), loaded(bytes + kLane * l));
  }
  for (size_t l = 1; l < kLanes; l++) lanes[l] = _mm_xor_si128(moved<kLane>(lanes[l - 1]), lanes[l]);
  alignas(16) uint8_t rest[kLane];
  _mm_store_si128((__m128i *)rest, lanes[kLanes - 1]);
  return by_tables(rest, kLane, 0);
}

// The same, four lanes in a register: as fast as memory is read. What is left has the same remainder as all bytes.
constexpr size_t kWideStride = 4 * kStride, kAhead = 4096;
#define WIDE __attribute__((target("avx512f,avx512vl,avx512dq,avx512bw,vpclmulqdq,sse4.2,pclmul")))

WIDE inline __m512i moved_wide(__m512i lanes) {
  constexpr int64_t low = factor(8 * (int)kWideStride + 32), high = factor(8 * (int)kWideStride - 32);
  const __m512i factors = _mm512_set_epi64(high, low, high, low, high, low, high, low);
  return _mm512_xor_si512(_mm512_clmulepi64_epi128(lanes, factors, 0x00),
                          _mm512_clmulepi64_epi128(lanes, factors, 0x11));
}

WIDE uint32_t by_wide_strides(const uint8_t *bytes, size_t strides, uint32_t state) {
  __m512i lanes[kLanes];
  for (size_t l = 0; l < kLanes; l++) lanes[l] = _mm512_loadu_si512(bytes + kStride * l);
  lanes[0] = _mm512_xor_si512(lanes[0], _mm512_zextsi128_si512(_mm_cvtsi32_si128((int)state)));
  for (size_t s = 1; s < strides; s++) {
    bytes += kWideStride;
    for (size_t l = 0; l < kLanes; l++) _mm_prefetch((const char *)bytes + kAhead + kStride * l, _MM_HINT_T0);
    for (size_t l = 0; l < kLanes; l++)
      lanes[l] = _mm512_xor_si512(moved_wide(lanes[l]), _mm512_loadu_si512(bytes + kStride * l));
  }
  alignas(64) uint8_t rest[kWideStride];
  for (size_t l = 0; l < kLanes; l++) _mm512_store_si512(rest + kStride * l, lanes[l]);
  return by_strides(rest, kLanes, 0);
}

#endif

uint32_t sum_of(const uint8_t *bytes, size_t count, uint32_t value) {
  uint32_t state = ~value;
#if defined(__x86_64__)
  static const Processor processor;
  const size_t wide = processor.wide_carryless ? count / kWideStride : 0;
  if (wide) state = by_wide_strides(bytes, wide, state);
  bytes += wide * kWideStride, count -= wide * kWideStride;
  const size_t strides = processor.carryless ? count / kStride : 0;
  if (strides) state = by_strides(bytes, strides, state);
  bytes += strides * kStride, count -= strides * kStride;
#endif
  return ~by_tables(bytes, count, state);
}

}  // namespace

uint32_t crc32(const uint8_t *bytes, size_t count, uint32_t value, int threads) {
  const int parts = (int)std::clamp<size_t>(count / kPart, 1, (size_t)threads);
  std::vector<uint32_t> sums(parts);
  over_parts(count, parts, [&](int part, size_t begin, size_t end) {
    sums[part] = sum_of(bytes + begin, end - begin, part ? 0 : value);
  });
  for (int part = 1; part < parts; part++) {
    const size_t begin = part_start(count, parts, part), end = part_start(count, parts, part + 1);
    sums[part] ^= moved_on(sums[part - 1], end - begin);
  }
  return sums.back();
}

}  // namespace drsplat
