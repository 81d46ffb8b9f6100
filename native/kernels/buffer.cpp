#include "kernels/buffer.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <new>

namespace drsplat {

Buffer::~Buffer() { std::free(data); }

void grow(Buffer &buffer, size_t bytes) {
  const size_t wanted = (std::max(2 * buffer.bytes, bytes) + 63) / 64 * 64;
  void *grown = std::aligned_alloc(64, wanted);
  if (!grown) throw std::bad_alloc();
  if (buffer.bytes) std::memcpy(grown, buffer.data, buffer.bytes);
  std::free(buffer.data);
  buffer.data = grown, buffer.bytes = wanted;
}

}  // namespace drsplat
