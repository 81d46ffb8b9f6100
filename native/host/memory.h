// Arrays that live from view to view, on huge pages where the system has them: rows of a scene are visited
// in depth or tile order, and then looking up the pages costs more than reading the rows.
#pragma once
#include <cstdlib>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace drsplat {

template <class T>
struct HugePages {
  using value_type = T;
  static constexpr size_t kPage = 2 << 20, kWorthwhile = 2 * kPage;

  HugePages() = default;
  template <class U>
  HugePages(const HugePages<U> &) {}

  T *allocate(size_t count) {
    const size_t bytes = count * sizeof(T), alignment = bytes >= kWorthwhile ? kPage : 64;
    void *memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
    if (!memory) throw std::bad_alloc();
#if defined(__linux__)
    if (bytes >= kWorthwhile) madvise(memory, bytes, MADV_HUGEPAGE);  // a wish: nothing is lost if it is refused
#endif
    return (T *)memory;
  }
  void deallocate(T *memory, size_t) { std::free(memory); }
  friend bool operator==(HugePages, HugePages) { return true; }
  friend bool operator!=(HugePages, HugePages) { return false; }
};

template <class T>
using Kept = std::vector<T, HugePages<T>>;

template <class T>
void grow(Kept<T> &v, size_t n) {
  if (v.size() < n) v.resize(n);
}

}  // namespace drsplat
