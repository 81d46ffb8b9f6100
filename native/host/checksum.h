// CRC-32 of bytes, as zlib's `crc32`, several times as fast where the processor multiplies without carries.
#pragma once
#include <cstddef>
#include <cstdint>

namespace drsplat {

// Of what `value` is of, and then these bytes.
uint32_t crc32(const uint8_t *bytes, size_t count, uint32_t value, int threads);

}  // namespace drsplat
