// Python face of algebra.cpp. As in bindings.cpp, only what memory safety needs is checked here.
#include "bindings.h"
#include "row_algebra.h"

#include <nanobind/stl/optional.h>

#include <optional>

using namespace drsplat;

namespace {

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
    ok = weighted_rows(kernels, {start, columns.data(), weights.data()}, {embeddings.data(), (uint32_t)embeddings.shape(0), (uint32_t)dim}, rows, thread_count(threads), out.get());
  }
  require(ok, "column indices of existing embeddings");
  return out.numpy({rows, dim});
}

nb::object pq_encode_of(Array<float, 2> features, Array<float, 3> centroids, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = features.shape(0), subvectors = centroids.shape(0), dim = centroids.shape(2);
  require(centroids.shape(1) == 256 && subvectors > 0 && dim > 0 && subvectors * dim == features.shape(1) && subvectors < (1u << 24) && dim < (1u << 24), "centroids (L, 256, D / L), L and D above 0");
  Fresh<uint8_t> codes(rows * subvectors);
  {
    nb::gil_scoped_release release;
    pq_encode(kernels, {centroids.data(), (uint32_t)subvectors, (uint32_t)dim}, features.data(), rows, thread_count(threads), codes.get());
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
    pq_scores(kernels, {codes.data(), lut.data(), scale.data(), bias ? bias->data() : nullptr, (uint32_t)lut.shape(0)}, rows, thread_count(threads), scores.get());
  }
  return scores.numpy({rows});
}

}  // namespace

void bind_algebra(nb::module_ &m) {
  m.def("weighted_rows", &weighted_rows_of, "starts"_a, "columns"_a, "weights"_a, "embeddings"_a, "threads"_a, "isa"_a);
  m.def("pq_encode", &pq_encode_of, "features"_a, "centroids"_a, "threads"_a, "isa"_a);
  m.def("pq_scores", &pq_scores_of, "codes"_a, "lut"_a, "scale"_a, "bias"_a.none(), "threads"_a, "isa"_a);
}
