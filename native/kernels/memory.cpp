#include "kernels/memory.h"

#include <new>

#if defined(_WIN32)
#include <malloc.h>
#else
#include <cstdlib>
#endif
#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace drsplat {

namespace {

constexpr size_t kLine = 64, kHugePage = 2 << 20, kWorthwhile = 2 * kHugePage;

void *aligned(size_t alignment, size_t bytes) {
#if defined(_WIN32)
  return _aligned_malloc(bytes, alignment);
#else
  void *memory = nullptr;  // posix_memalign: macOS before 10.15 has no aligned_alloc
  return posix_memalign(&memory, alignment, bytes) ? nullptr : memory;
#endif
}

}  // namespace

void *allocate(size_t bytes) {
  const bool large = bytes >= kWorthwhile;
  void *memory = aligned(large ? kHugePage : kLine, bytes ? bytes : kLine);
  if (!memory) throw std::bad_alloc();
#if defined(__linux__)
  if (large) madvise(memory, bytes, MADV_HUGEPAGE);  // a wish: nothing is lost if it is refused
#endif
  return memory;
}

void release(void *memory) {
#if defined(_WIN32)
  _aligned_free(memory);
#else
  std::free(memory);
#endif
}

}  // namespace drsplat
