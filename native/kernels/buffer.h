// A growing array without std:: (see isa.h). 64-byte aligned; never shrinks.
#pragma once
#include <cstddef>

namespace drsplat {

struct Buffer {
  void *data = nullptr;
  size_t bytes = 0;

  Buffer() = default;
  Buffer(const Buffer &) = delete;
  ~Buffer();
};

// More bytes, of which the first are those there were; std::bad_alloc where there is no room.
void grow(Buffer &, size_t bytes);

static inline void reserve(Buffer &buffer, size_t bytes) {
  if (bytes > buffer.bytes) grow(buffer, bytes);
}

}  // namespace drsplat
