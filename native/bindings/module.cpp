#include "bindings/module.h"

#include "bindings/arrays.h"

using namespace drsplat;

NB_MODULE(_native, m) {
  bind_algebra(m);
  bind_boxes(m);
  bind_mixture(m);
  bind_photos(m);
  bind_regions(m);
  bind_scan(m);
  bind_splatting(m);
  bind_training(m);
  m.def("available_isas", [] {
    nb::list names;
    for (auto list = available_kernels(); *list; list++) names.append((*list)->name);
    return names;
  });
#if defined(__clang__)
  m.attr("compiler") = "Clang " __clang_version__;
#else
  m.attr("compiler") = "GCC " __VERSION__;
#endif
  m.def("default_isa", [] { return std::string(kernels_named("").name); });
}
