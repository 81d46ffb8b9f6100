// What the bindings share: checked arguments, and results that NumPy owns without a copy.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <initializer_list>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

#include "host/candidates.h"
#include "host/dispatch.h"
#include "host/memory.h"

namespace drsplat {

namespace nb = nanobind;
using namespace nb::literals;

template <class T, int Dimensions>
using Array = nb::ndarray<const T, nb::ndim<Dimensions>, nb::c_contig, nb::device::cpu>;

using Vector = Array<float, 1>;
using Rows = Array<float, 2>;

inline void require(bool ok, const char *what) {
  if (!ok) throw std::invalid_argument(what);
}

// A member of a tuple as what it has to be, without a conversion. An array is to be held as long as it is read: what
// the tuple has may export a copy that nobody else holds.
template <class T>
T member(const nb::tuple &whole, size_t place, const char *what) {
  T value;
  require(nb::try_cast(whole[place], value, std::is_arithmetic_v<T>), what);
  return value;
}

inline const Kernels &kernels_named(const std::string &isa) {
  const Kernels *kernels = find_kernels(isa.c_str());
  if (!kernels)
    throw std::invalid_argument("instruction set '" + isa + "' is not available on this machine or in this build");
  return *kernels;
}

inline int thread_count(int threads) {
  return threads > 0 ? std::min(threads, 256) : std::max(1u, std::thread::hardware_concurrency());
}

// Memory that the kernels write and that then belongs to NumPy.
template <class T>
struct Fresh {
  Unset<T> values;
  explicit Fresh(size_t count) : values(unset<T>(count)) {}
  Fresh(size_t count, T fill) : Fresh(count) { std::fill_n(values.get(), count, fill); }
  T *get() const { return values.get(); }
  nb::object numpy(std::initializer_list<size_t> shape) {
    T *owned = values.release();
    nb::capsule owner(owned, [](void *p) noexcept { release(p); });
    return nb::cast(nb::ndarray<nb::numpy, T>(owned, shape, owner));
  }
};

template <class T>
nb::object to_numpy(std::vector<T> &&values) {
  auto *owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void *p) noexcept { delete (std::vector<T> *)p; });
  return nb::cast(nb::ndarray<nb::numpy, T>(owned->data(), {owned->size()}, owner));
}

inline nb::tuple rows_and_scores(Found found) {
  return nb::make_tuple(to_numpy(std::move(found.rows)), to_numpy(std::move(found.scores)));
}

// CSR: one more start than there are rows, of entries that exist.
inline void require_starts(const Array<int64_t, 1> &starts, size_t entries) {
  require(starts.shape(0) > 0, "one more row start than rows");
  const int64_t *start = starts.data();
  const size_t rows = starts.shape(0) - 1;
  require(start[0] >= 0 && start[rows] <= (int64_t)entries, "row starts within the entries");
  for (size_t i = 0; i < rows; i++) require(start[i] <= start[i + 1], "row starts that do not fall");
}

inline void require_sh(const Array<float, 3> &sh, size_t gaussians) {
  const size_t k = sh.shape(1);
  require(sh.shape(0) == gaussians && sh.shape(2) == 3 && (k == 1 || k == 4 || k == 9 || k == 16),
          "sh (N, 1 | 4 | 9 | 16, 3)");
}

template <class Work>
auto without_gil(Work work) {
  const nb::gil_scoped_release release;
  return work();
}

// camera: rotation row by row (9), translation (3), fx, fy, cx, cy, near
inline Camera camera_of(const Array<float, 1> &camera, int width, int height) {
  require(camera.shape(0) == 17, "camera: 17 numbers");
  require(camera.data()[16] > 0, "camera: a near plane in front of it");
  require(width > 0 && height > 0 && width <= 65536 && height <= 65536, "width and height: 1 to 65536");
  Camera c;
  std::copy_n(camera.data(), 9, c.rotation);
  std::copy_n(camera.data() + 9, 3, c.translation);
  c.fx = camera.data()[12], c.fy = camera.data()[13], c.cx = camera.data()[14], c.cy = camera.data()[15],
  c.near_z = camera.data()[16];
  c.width = width, c.height = height;
  return c;
}

}  // namespace drsplat
