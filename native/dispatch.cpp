// Picks the kernels for this machine at run time.
#include "kernels.h"

#include <cstdlib>
#include <cstring>
#include <new>

namespace drsplat {

#if DRSPLAT_X86
namespace v2 { extern const Kernels table; }
namespace v3 { extern const Kernels table; }
namespace v4 { extern const Kernels table; }

const Kernels *const *available_kernels() {
  static const Kernels *list[4] = {};
  static const bool filled = [] {
    __builtin_cpu_init();
    const bool has_v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    const bool has_v4 = has_v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512cd");
    int n = 0;
    if (has_v4) list[n++] = &v4::table;
    if (has_v3) list[n++] = &v3::table;
    list[n++] = &v2::table;
    return true;
  }();
  (void)filled;
  return list;
}
#else
namespace portable { extern const Kernels table; }

const Kernels *const *available_kernels() {
  static const Kernels *list[2] = {&portable::table, nullptr};
  return list;
}
#endif

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

void out_of_memory() { throw std::bad_alloc(); }

}  // namespace drsplat
