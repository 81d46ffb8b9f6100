#include "host/dispatch.h"

#include "host/processor.h"
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
namespace v4_vbmi {
extern const ScanKernels scan_table;
extern const MixtureKernels mixture_table;
}  // namespace v4_vbmi
#endif

namespace {

struct Available {
  const Kernels *list[6] = {};  // null at the end
  Kernels with_bytes;           // v4, but for scans and mixtures
  Available() {
    int n = 0;
#if defined(__x86_64__)
    [[maybe_unused]] const Processor processor;
#endif
#if DRSPLAT_HAS_v4_vbmi
    if (processor.vbmi) {
      with_bytes = v4::table;
      with_bytes.name = "v4_vbmi";
      with_bytes.scan = &v4_vbmi::scan_table, with_bytes.mixture = &v4_vbmi::mixture_table;
      list[n++] = &with_bytes;
    }
#endif
#if DRSPLAT_HAS_v4
    if (processor.v4) list[n++] = &v4::table;
#endif
#if DRSPLAT_HAS_v3
    if (processor.v3) list[n++] = &v3::table;
#endif
#if DRSPLAT_HAS_v2
    if (processor.v2) list[n++] = &v2::table;
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
