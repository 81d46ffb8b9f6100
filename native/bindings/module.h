// The Python module, a file for each of its parts: contiguous arrays in, arrays out, the GIL released while working.
// Shapes are checked only as far as memory safety needs; drsplat.kernels has the friendly messages.
#pragma once
#include <nanobind/nanobind.h>

void bind_algebra(nanobind::module_ &);
void bind_boxes(nanobind::module_ &);
void bind_mixture(nanobind::module_ &);
void bind_photos(nanobind::module_ &);
void bind_regions(nanobind::module_ &);
void bind_scan(nanobind::module_ &);
void bind_splatting(nanobind::module_ &);
void bind_training(nanobind::module_ &);
