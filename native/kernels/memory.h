// Memory from the system: the one place with calls that are not the same on every system.
#pragma once
#include <cstddef>

namespace drsplat {

// Aligned to 64 bytes; much of it to huge pages, where the system has them. std::bad_alloc where there is no room.
void *allocate(size_t bytes);
void release(void *memory);

}  // namespace drsplat
