// Large arrays, and those that live from view to view, on huge pages where the system has them: rows of a scene are
// visited in depth or tile order, and then looking up the pages costs more than reading the rows.
#pragma once
#include "kernels/memory.h"

#include <cstdint>
#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace drsplat {

template <class T>
struct HugePages {
  using value_type = T;

  HugePages() = default;
  template <class U>
  HugePages(const HugePages<U> &) {}

  T *allocate(size_t count) { return (T *)drsplat::allocate(count * sizeof(T)); }
  void deallocate(T *memory, size_t) { release(memory); }
  // What is not given stays unset: pages on which nobody writes take no memory.
  template <class U>
  void construct(U *place) {
    ::new ((void *)place) U;
  }
  template <class U, class Value>
  void construct(U *place, Value &&value) {
    ::new ((void *)place) U(std::forward<Value>(value));
  }
  friend bool operator==(HugePages, HugePages) { return true; }
  friend bool operator!=(HugePages, HugePages) { return false; }
};

template <class T>
using Kept = std::vector<T, HugePages<T>>;

struct Released {
  void operator()(void *memory) const { release(memory); }
};

// Numbers that nobody has set yet.
template <class T>
using Unset = std::unique_ptr<T[], Released>;

template <class T>
Unset<T> unset(size_t count) {
  if (count > SIZE_MAX / sizeof(T)) throw std::bad_alloc();
  return Unset<T>((T *)allocate(count * sizeof(T)));
}

template <class T>
void grow(Kept<T> &v, size_t n) {
  if (v.size() < n) v.resize(n);
}

}  // namespace drsplat
