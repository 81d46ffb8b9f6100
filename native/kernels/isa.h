// For code that is compiled once per instruction set, each copy in a namespace of its own. All of it is static or a
// template of its own: the linker must not share a symbol between the copies, so that none of std:: may be instantiated
// (see CMakeLists.txt).
#pragma once
#include <stdint.h>
#include <string.h>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

// What only fetches must be INLINE too: GCC drops calls of functions that change nothing before it inlines them.
#define INLINE static inline __attribute__((always_inline))
