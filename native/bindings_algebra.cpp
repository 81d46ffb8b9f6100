// Python face of algebra.cpp. As in bindings.cpp, only what memory safety needs is checked here.
#include "row_algebra.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>

namespace nb = nanobind;
using namespace nb::literals;
using namespace drsplat;

namespace {

template <class T, int Dimensions>
using Array = nb::ndarray<const T, nb::ndim<Dimensions>, nb::c_contig, nb::device::cpu>;

void require(bool ok, const char *what) {
  if (!ok) throw std::invalid_argument(what);
}

const Kernels &kernels_named(const std::string &isa) {
  const Kernels *kernels = find_kernels(isa.c_str());
  if (!kernels) throw std::invalid_argument("instruction set '" + isa + "' is not available on this machine or in this build");
  return *kernels;
}

int thread_count(int threads) { return threads > 0 ? std::min(threads, 256) : std::max(1u, std::thread::hardware_concurrency()); }

// Memory that is written once, by the kernels, and then belongs to NumPy.
template <class T>
struct Fresh {
  std::unique_ptr<T[]> values;
  explicit Fresh(size_t count) : values(new T[std::max<size_t>(count, 1)]) {}
  nb::object numpy(std::initializer_list<size_t> shape) {
    T *owned = values.release();
    nb::capsule owner(owned, [](void *p) noexcept { delete[] (T *)p; });
    return nb::cast(nb::ndarray<nb::numpy, T>(owned, shape, owner));
  }
};

nb::object weighted_rows_of(Array<int64_t, 1> starts, Array<int32_t, 1> columns, Array<float, 1> weights, Array<float, 2> embeddings, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  require(starts.shape(0) >= 1 && columns.shape(0) == weights.shape(0), "starts (rows + 1), columns and weights of one length");
  require(embeddings.shape(0) < (1u << 31) && embeddings.shape(1) < (1u << 24), "fewer than 2^31 embeddings of fewer than 2^24 numbers");
  const size_t rows = starts.shape(0) - 1, dim = embeddings.shape(1);
  const int64_t *start = starts.data();
  require(start[0] >= 0 && start[rows] <= (int64_t)columns.shape(0), "row starts within the entries");
  for (size_t i = 0; i < rows; i++) require(start[i] <= start[i + 1], "row starts that do not fall");
  Fresh<float> out(rows * dim);
  bool ok;
  {
    nb::gil_scoped_release release;
    ok = weighted_rows(kernels, {start, columns.data(), weights.data()}, {embeddings.data(), (uint32_t)embeddings.shape(0), (uint32_t)dim}, rows, thread_count(threads), out.values.get());
  }
  require(ok, "column indices of existing embeddings");
  return out.numpy({rows, dim});
}

nb::object pq_encode_of(Array<float, 2> features, Array<float, 3> centroids, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = features.shape(0), subvectors = centroids.shape(0), dim = centroids.shape(2);
  require(centroids.shape(1) == 256 && subvectors * dim == features.shape(1) && subvectors < (1u << 24) && dim < (1u << 24), "centroids (L, 256, D / L)");
  Fresh<uint8_t> codes(rows * subvectors);
  {
    nb::gil_scoped_release release;
    pq_encode(kernels, {centroids.data(), (uint32_t)subvectors, (uint32_t)dim}, features.data(), rows, thread_count(threads), codes.values.get());
  }
  return codes.numpy({rows, subvectors});
}

nb::object pq_scores_of(Array<uint8_t, 2> codes, Array<float, 2> lut, Array<float, 1> scale, std::optional<Array<float, 1>> bias, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = codes.shape(0);
  require(lut.shape(0) == codes.shape(1) && lut.shape(1) == 256 && lut.shape(0) < (1u << 24), "lut (L, 256)");
  require(scale.shape(0) == rows && (!bias || bias->shape(0) == rows), "one scale and one bias per row");
  Fresh<float> scores(rows);
  {
    nb::gil_scoped_release release;
    pq_scores(kernels, {codes.data(), lut.data(), scale.data(), bias ? bias->data() : nullptr, (uint32_t)lut.shape(0)}, rows, thread_count(threads), scores.values.get());
  }
  return scores.numpy({rows});
}

}  // namespace

void bind_algebra(nb::module_ &m) {
  m.def("weighted_rows", &weighted_rows_of, "starts"_a, "columns"_a, "weights"_a, "embeddings"_a, "threads"_a, "isa"_a);
  m.def("pq_encode", &pq_encode_of, "features"_a, "centroids"_a, "threads"_a, "isa"_a);
  m.def("pq_scores", &pq_scores_of, "codes"_a, "lut"_a, "scale"_a, "bias"_a.none(), "threads"_a, "isa"_a);
}
