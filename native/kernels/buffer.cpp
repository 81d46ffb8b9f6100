#include "kernels/buffer.h"

#include "kernels/memory.h"

#include <algorithm>
#include <cstring>

namespace drsplat {

Buffer::~Buffer() { release(data); }

void grow(Buffer &buffer, size_t bytes) {
  const size_t wanted = (std::max(2 * buffer.bytes, bytes) + 63) / 64 * 64;
  void *grown = allocate(wanted);
  if (buffer.bytes) std::memcpy(grown, buffer.data, buffer.bytes);
  release(buffer.data);
  buffer.data = grown, buffer.bytes = wanted;
}

}  // namespace drsplat
