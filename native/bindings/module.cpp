#include "bindings/module.h"

#include "bindings/arrays.h"
#include "host/checksum.h"

using namespace drsplat;

namespace {

uint32_t crc32_of(nb::handle bytes, uint32_t value) {
  Py_buffer view;
  if (PyObject_GetBuffer(bytes.ptr(), &view, PyBUF_SIMPLE)) throw nb::python_error();
  value = without_gil([&] { return crc32((const uint8_t *)view.buf, (size_t)view.len, value, thread_count(0)); });
  PyBuffer_Release(&view);
  return value;
}

}  // namespace

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
  m.def("crc32", &crc32_of, "bytes"_a, "value"_a);
#if defined(__clang__)
  m.attr("compiler") = "Clang " __clang_version__;
#else
  m.attr("compiler") = "GCC " __VERSION__;
#endif
  m.def("default_isa", [] { return std::string(kernels_named("").name); });
}
