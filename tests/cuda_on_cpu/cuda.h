// CUDA's words for a C++ compiler: the threads of a block are fibers that take turns, a barrier is where they meet.
#pragma once
#include <math.h>
#include <setjmp.h>
#include <stdint.h>
#include <string.h>
#include <ucontext.h>

#include <stdexcept>
#include <vector>

struct uint3 { unsigned x, y, z; };
struct alignas(8) float2 { float x, y; };
struct alignas(16) float4 { float x, y, z, w; };
struct alignas(16) uint4 { unsigned x, y, z, w; };
static inline float2 make_float2(float x, float y) { return {x, y}; }
static inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }

namespace emulated {
enum { kMostThreads = 1024, kStack = 1 << 16 };
struct Meeting { unsigned arrived = 0, round = 0; };  // of those who wait for each other
static ucontext_t fibers[kMostThreads];
static jmp_buf scheduler_at, fibers_at[kMostThreads];  // of those that have begun: jumps make no system calls
static bool begun[kMostThreads];
static bool ended[kMostThreads];
static unsigned current, threads;
static Meeting block_meeting, warp_meetings[kMostThreads / 32];
static uint64_t lanes[kMostThreads / 32][32];  // what each lane shows the others
static int counted[2];
static unsigned char shared[1 << 18];
static std::vector<unsigned char> stacks;
static void (*body)(void **);
static void **arguments;
static inline void turn() {
  if (!_setjmp(fibers_at[current])) _longjmp(scheduler_at, 1);
}
static __attribute__((noinline)) void resume(unsigned index) {
  if (_setjmp(scheduler_at)) return;
  if (begun[index]) _longjmp(fibers_at[index], 1);
  begun[index] = true;
  setcontext(&fibers[index]);
}
static inline void meet(Meeting &m, unsigned expected) {
  const unsigned round = m.round;
  if (++m.arrived == expected) m.arrived = 0, m.round++;
  else
    while (m.round == round) turn();
}
}  // namespace emulated

static uint3 threadIdx, blockIdx, blockDim, gridDim;

namespace emulated {
static void run_fiber(unsigned index) {
  body(arguments);
  ended[index] = true;
  for (;;) turn();
}
static unsigned meetings() {
  unsigned sum = block_meeting.round + block_meeting.arrived;
  for (auto &m : warp_meetings) sum += m.round + m.arrived;
  return sum;
}
static int run_block() {
  bool stuck = false;
  threads = blockDim.x;
  block_meeting = {};
  for (auto &m : warp_meetings) m = {};
  for (unsigned i = 0; i < threads; i++) {
    ended[i] = begun[i] = false;
    getcontext(&fibers[i]);
    fibers[i].uc_stack.ss_sp = stacks.data() + (size_t)i * kStack;
    fibers[i].uc_stack.ss_size = kStack;
    fibers[i].uc_link = nullptr;
    makecontext(&fibers[i], (void (*)())run_fiber, 1, i);
  }
  for (unsigned left = threads, idle = 0; left && idle < 4;) {  // 4: they wait for others that never come
    const unsigned before = left, met = meetings();
    for (unsigned i = 0; i < threads; i++) {
      if (ended[i]) continue;
      current = i, threadIdx = {i, 0, 0};
      resume(i);
      left -= ended[i];
    }
    idle = left == before && met == meetings() ? idle + 1 : 0;
    stuck = left > 0;
  }
  return stuck;
}
}  // namespace emulated

// 0, or 1 where the threads of a block wait for each other for ever.
static int run_grid(void (*body)(void **), void **arguments, unsigned blocks_x, unsigned blocks_y, unsigned threads) {
  emulated::stacks.resize((size_t)emulated::kMostThreads * emulated::kStack);
  emulated::body = body, emulated::arguments = arguments;
  blockDim = {threads, 1, 1}, gridDim = {blocks_x, blocks_y, 1};
  for (unsigned y = 0; y < blocks_y; y++)
    for (unsigned x = 0; x < blocks_x; x++) {
      blockIdx = {x, y, 0};
      memset(emulated::shared, 0xcd, sizeof emulated::shared);  // nobody may rely on what was there
      if (emulated::run_block()) return 1;
    }
  return 0;
}

#define __global__
#define __device__
#define __forceinline__ inline __attribute__((always_inline))
#define __launch_bounds__(...)
#define __shared__ static
#define __restrict__
#define DYNAMIC_SHARED(type, name) type *name = (type *)emulated::shared

static inline void __syncthreads() { emulated::meet(emulated::block_meeting, emulated::threads); }
static inline int __syncthreads_count(int predicate) {
  using namespace emulated;
  __syncthreads();
  if (current == 0) counted[0] = 0;
  __syncthreads();
  counted[0] += predicate != 0;
  __syncthreads();
  return counted[0];
}
static inline int __syncthreads_or(int predicate) { return __syncthreads_count(predicate) != 0; }
static inline void __syncwarp(unsigned = ~0u) { emulated::meet(emulated::warp_meetings[emulated::current / 32], 32); }

template <class T>
static inline T of_lane(T mine, int lane) {
  using namespace emulated;
  auto &shown = lanes[current / 32];
  memcpy(&shown[current % 32], &mine, sizeof(T));
  __syncwarp();
  T other;
  memcpy(&other, &shown[lane & 31], sizeof(T));
  __syncwarp();
  return other;
}
template <class T>
static inline T __shfl_sync(unsigned, T a, int lane) { return of_lane(a, lane); }
template <class T>
static inline T __shfl_xor_sync(unsigned, T a, int mask) { return of_lane(a, (int)(emulated::current & 31) ^ mask); }
template <class T>
static inline T __shfl_up_sync(unsigned, T a, int step) {
  const int lane = (int)(emulated::current & 31);
  return of_lane(a, lane < step ? lane : lane - step);
}
static inline unsigned __ballot_sync(unsigned, int predicate) {
  using namespace emulated;
  auto &shown = lanes[current / 32];
  shown[current % 32] = predicate != 0;
  __syncwarp();
  unsigned bits = 0;
  for (int i = 0; i < 32; i++) bits |= (unsigned)shown[i] << i;
  __syncwarp();
  return bits;
}
static inline int __any_sync(unsigned m, int predicate) { return __ballot_sync(m, predicate) != 0; }

static inline unsigned atomicAdd(unsigned *at, unsigned a) {
  const unsigned before = *at;
  *at += a;
  return before;
}
static inline void __threadfence() {}
static inline int __popc(unsigned a) { return __builtin_popcount(a); }
static inline int __ffs(unsigned a) { return __builtin_ffs((int)a); }
static inline unsigned __float_as_uint(float a) {
  unsigned bits;
  memcpy(&bits, &a, 4);
  return bits;
}
static inline float __uint_as_float(unsigned bits) {
  float a;
  memcpy(&a, &bits, 4);
  return a;
}
static inline float __fmul_rn(float a, float b) { return a * b; }  // compiled with -ffp-contract=off
static inline float __fadd_rn(float a, float b) { return a + b; }
static inline float __fsub_rn(float a, float b) { return a - b; }
static inline float __fmaf_rn(float a, float b, float c) { return fmaf(a, b, c); }
template <class T>
static inline T __ldg(const T *p) { return *p; }
template <class T>
static inline T __ldcs(const T *p) { return *p; }
static inline unsigned __byte_perm(unsigned low, unsigned high, unsigned chosen) {
  const uint64_t both = (uint64_t)high << 32 | low;
  unsigned bytes = 0;
  for (int i = 0; i < 4; i++) bytes |= (unsigned)(both >> 8 * (chosen >> 4 * i & 7) & 255) << 8 * i;
  return bytes;
}
static inline int min(int a, int b) { return a < b ? a : b; }
static inline int max(int a, int b) { return a > b ? a : b; }
