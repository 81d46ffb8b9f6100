// What an x86-64 processor can do and the system lets it do, by the cpuid instruction: Clang for Windows links no
// __builtin_cpu_supports.
#pragma once
#if defined(__x86_64__)
#include <cpuid.h>

#include <cstdint>

namespace drsplat {

struct Processor {
  bool v2 = false, v3 = false, v4 = false, vbmi = false;  // all that kernels of that level use
  bool carryless = false;                                 // multiplication, and what v2 has
  bool wide_carryless = false;                            // the same in registers of 64 bytes, and what v4 has

  Processor() {
    uint32_t a, b, c, d, b7, c7;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return;
    constexpr uint32_t kFma = 1 << 12, kSse42 = 1 << 20, kPopcnt = 1 << 23, kSavesMore = 1 << 27, kAvx = 1 << 28,
                       kF16c = 1 << 29;
    v2 = has(c, kSse42 | kPopcnt);
    constexpr uint32_t kClmul = 1 << 1;
    carryless = v2 && has(c, kClmul);
    if (!v2 || !has(c, kSavesMore | kAvx | kFma | kF16c) || !__get_cpuid_count(7, 0, &a, &b7, &c7, &d)) return;
    constexpr uint32_t kBmi1 = 1 << 3, kAvx2 = 1 << 5, kBmi2 = 1 << 8, kVbmi = 1 << 1, kVnni = 1 << 11,
                       kWideClmul = 1 << 10;
    constexpr uint32_t kF = 1 << 16, kDq = 1 << 17, kCd = 1 << 28, kBw = 1 << 30, kVl = 1u << 31;
    constexpr uint32_t kWide = 6, kWidest = 0xe6;  // registers that the system saves for each program
    const uint32_t saved = saved_registers();
    v3 = has(saved, kWide) && has(b7, kBmi1 | kAvx2 | kBmi2);
    v4 = v3 && has(saved, kWidest) && has(b7, kF | kDq | kCd | kBw | kVl);
    vbmi = v4 && has(c7, kVbmi | kVnni);
    wide_carryless = v4 && carryless && has(c7, kWideClmul);
  }

 private:
  static bool has(uint32_t word, uint32_t bits) { return (word & bits) == bits; }

  static uint32_t saved_registers() {
    uint32_t low, high;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
  }
};

}  // namespace drsplat
#endif
