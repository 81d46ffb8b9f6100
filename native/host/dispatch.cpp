#include "host/dispatch.h"

#include "kernels/scan_kernels.h"

#include <cstdlib>
#include <cstring>

namespace drsplat {

namespace portable { extern const Kernels table; }
#if DRSPLAT_HAS_v2
namespace v2 { extern const Kernels table; }
#endif
#if DRSPLAT_HAS_v3
namespace v3 { extern const Kernels table; }
#endif
#if DRSPLAT_HAS_v4
namespace v4 { extern const Kernels table; }
#endif
#if DRSPLAT_HAS_v4_vbmi
namespace v4_vbmi { extern const ScanKernels scan_table; }
#endif

namespace {

struct Available {
  const Kernels *list[6] = {};  // null at the end
  Kernels with_bytes;           // v4, but for the scans
  Available() {
    int n = 0;
#if defined(__x86_64__)
    __builtin_cpu_init();
    [[maybe_unused]] const bool has_v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    [[maybe_unused]] const bool has_v3 =
        has_v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    [[maybe_unused]] const bool has_v4 = has_v3 && __builtin_cpu_supports("avx512f") &&
                                         __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
                                         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512cd");
#endif
#if DRSPLAT_HAS_v4_vbmi
    if (has_v4 && __builtin_cpu_supports("avx512vbmi")) {
      with_bytes = v4::table;
      with_bytes.name = "v4_vbmi", with_bytes.scan = &v4_vbmi::scan_table;
      list[n++] = &with_bytes;
    }
#endif
#if DRSPLAT_HAS_v4
    if (has_v4) list[n++] = &v4::table;
#endif
#if DRSPLAT_HAS_v3
    if (has_v3) list[n++] = &v3::table;
#endif
#if DRSPLAT_HAS_v2
    if (has_v2) list[n++] = &v2::table;
#endif
    list[n++] = &portable::table;
  }
};

}  // namespace

const Kernels *const *available_kernels() {
  static const Available available;
  return available.list;
}

const Kernels *find_kernels(const char *name) {
  const Kernels *const *list = available_kernels();
  if (!*name) {
    const char *wanted = std::getenv("DRSPLAT_ISA");
    if (!wanted || !*wanted) return list[0];
    name = wanted;
  }
  for (; *list; list++)
    if (!std::strcmp((*list)->name, name)) return *list;
  return nullptr;
}

}  // namespace drsplat
