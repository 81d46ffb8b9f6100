#include "host/algebra.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

using namespace drsplat;

namespace {

nb::object weighted_rows_of(Array<int64_t, 1> starts, Array<int32_t, 1> columns, Vector weights, Rows embeddings,
                            int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  require(starts.shape(0) >= 1 && columns.shape(0) == weights.shape(0),
          "starts (rows + 1), columns and weights of one length");
  require(embeddings.shape(0) < (1u << 31) && embeddings.shape(1) < (1u << 24),
          "fewer than 2^31 embeddings of fewer than 2^24 numbers");
  const size_t rows = starts.shape(0) - 1, dim = embeddings.shape(1);
  require_starts(starts, columns.shape(0));
  Fresh<float> out(rows * dim);
  const bool ok = without_gil([&] {
    return weighted_rows(kernels, {starts.data(), columns.data(), weights.data()},
                         {embeddings.data(), (uint32_t)embeddings.shape(0), (uint32_t)dim}, rows, thread_count(threads),
                         out.get());
  });
  require(ok, "column indices of existing embeddings");
  return out.numpy({rows, dim});
}

nb::object dense_rows_of(Rows a, Rows b, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = a.shape(0), depth = b.shape(0), width = b.shape(1);
  require(a.shape(1) == depth && depth < (1u << 24) && width < (1u << 24) && width % 16 == 0,
          "(n, k) and (k, m), m a multiple of 16, k and m below 2^24");
  Fresh<float> out(rows * width);
  without_gil([&] {
    dense_rows(kernels, a.data(), b.data(), rows, (uint32_t)depth, (uint32_t)width, thread_count(threads), out.get());
  });
  return out.numpy({rows, width});
}

nb::object convolve_of(Array<float, 4> images, Rows weights, Vector bias, int stride, int threads,
                       const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t count = images.shape(0), channels = images.shape(3), outputs = weights.shape(1);
  require(images.shape(1) <= 65536 && images.shape(2) <= 65536 && channels < (1u << 20) && outputs < (1u << 20),
          "up to 65536 x 65536 pixels of fewer than 2^20 channels");
  require(weights.shape(0) == 9 * channels && bias.shape(0) == outputs && outputs % 16 == 0 && stride > 0,
          "weights (9 c, o) and a bias (o) for images of c channels, o a multiple of 16, and a stride above 0");
  const Convolution c = {images.data(),
                         weights.data(),
                         bias.data(),
                         count,
                         (uint32_t)images.shape(1),
                         (uint32_t)images.shape(2),
                         (uint32_t)channels,
                         (uint32_t)outputs,
                         (uint32_t)stride};
  Fresh<float> out(count * c.rows() * c.columns() * outputs);
  without_gil([&] { convolve(kernels, c, thread_count(threads), out.get()); });
  return out.numpy({count, c.rows(), c.columns(), outputs});
}

nb::object pq_encode_of(Rows features, Array<float, 3> centroids, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = features.shape(0), subvectors = centroids.shape(0), dim = centroids.shape(2);
  require(centroids.shape(1) == 256 && subvectors > 0 && dim > 0 && subvectors * dim == features.shape(1) &&
              subvectors < (1u << 24) && dim < (1u << 24),
          "centroids (L, 256, D / L), L and D above 0");
  Fresh<uint8_t> codes(rows * subvectors);
  without_gil([&] {
    pq_encode(kernels, {centroids.data(), (uint32_t)subvectors, (uint32_t)dim}, features.data(), rows,
              thread_count(threads), codes.get());
  });
  return codes.numpy({rows, subvectors});
}

using Kept = nb::ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;  // written in place
using Names = nb::ndarray<uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void keep_best_of(Kept scores, Names names, Rows found, size_t first, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t kept = scores.shape(0), rows = scores.shape(1), count = found.shape(0);
  require(names.shape(0) == kept && names.shape(1) == rows && found.shape(1) == rows && kept > 0 && kept <= kMostKept,
          "scores and names (1 to 256, rows), found (count, rows)");
  require(count <= 65536 && first <= 65536 - count, "names below 65,536");
  without_gil([&] {
    keep_best(kernels,
              {scores.data(), names.data(), found.data(), rows, (uint32_t)kept, (uint32_t)count, (uint32_t)first},
              thread_count(threads));
  });
}

nb::tuple code_sums_of(Rows points, Array<uint8_t, 2> codes, int threads) {
  const size_t rows = points.shape(0), subvectors = codes.shape(1);
  require(codes.shape(0) == rows && subvectors > 0 && subvectors < (1u << 24) && points.shape(1) < (1u << 24) &&
              points.shape(1) % subvectors == 0,
          "points (n, D) and codes (n, L), L above 0 and D a multiple of it");
  const size_t dim = points.shape(1) / subvectors;
  Fresh<double> sums(subvectors * 256 * dim, 0);
  Fresh<int64_t> counts(subvectors * 256, 0);
  without_gil([&] {
    code_sums(points.data(), codes.data(), rows, (uint32_t)subvectors, (uint32_t)dim, thread_count(threads), sums.get(),
              counts.get());
  });
  return nb::make_tuple(sums.numpy({subvectors, 256, dim}), counts.numpy({subvectors, 256}));
}

nb::tuple changed_columns_of(Array<int64_t, 1> starts, Array<int32_t, 1> columns, Vector weights,
                             Array<int32_t, 1> numbers, Array<int64_t, 1> more_starts, Array<int32_t, 1> more_columns,
                             Vector more_weights, int threads) {
  require(columns.shape(0) == weights.shape(0) && more_columns.shape(0) == more_weights.shape(0),
          "columns and weights of one length");
  require_starts(starts, columns.shape(0));
  require_starts(more_starts, more_columns.shape(0));
  require(starts.shape(0) == more_starts.shape(0), "as many rows that are put in as there are");
  const size_t rows = starts.shape(0) - 1;
  const ColumnChange change = {{starts.data(), columns.data(), weights.data()},
                               {more_starts.data(), more_columns.data(), more_weights.data()},
                               numbers.data(),
                               rows,
                               numbers.shape(0)};
  Fresh<int64_t> ends(rows + 1);
  const int used = thread_count(threads);
  require(without_gil([&] { return changed_starts(change, used, ends.get()); }), "a number for each column");
  const size_t entries = (size_t)ends.get()[rows];
  Fresh<int32_t> new_columns(entries);
  Fresh<float> new_weights(entries);
  without_gil([&] { changed_rows(change, ends.get(), used, new_columns.get(), new_weights.get()); });
  return nb::make_tuple(ends.numpy({rows + 1}), new_columns.numpy({entries}), new_weights.numpy({entries}));
}

using Counts = nb::ndarray<int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;  // written in place
using Columns = nb::ndarray<int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void place_entries_of(Array<uint32_t, 1> rows, Array<int32_t, 1> columns, Vector weights, int32_t first_column,
                      Counts next, Columns all_columns, Weights all_weights) {
  const size_t count = rows.shape(0), room = all_columns.shape(0);
  require(columns.shape(0) == count && weights.shape(0) == count && all_weights.shape(0) == room,
          "columns and weights of one length");
  const bool ok = without_gil([&] {
    return place_entries({rows.data(), columns.data(), weights.data(), count, first_column}, next.data(), next.shape(0),
                         room, all_columns.data(), all_weights.data());
  });
  require(ok, "rows that there are, with room for their entries");
}

}  // namespace

void bind_algebra(nb::module_ &m) {
  m.def("weighted_rows", &weighted_rows_of, "starts"_a, "columns"_a, "weights"_a, "embeddings"_a, "threads"_a, "isa"_a);
  m.def("dense_rows", &dense_rows_of, "a"_a, "b"_a, "threads"_a, "isa"_a);
  m.def("convolve", &convolve_of, "images"_a, "weights"_a, "bias"_a, "stride"_a, "threads"_a, "isa"_a);
  m.def("changed_columns", &changed_columns_of, "starts"_a, "columns"_a, "weights"_a, "numbers"_a, "more_starts"_a,
        "more_columns"_a, "more_weights"_a, "threads"_a);
  m.def("place_entries", &place_entries_of, "rows"_a, "columns"_a, "weights"_a, "first_column"_a, "next"_a.noconvert(),
        "all_columns"_a.noconvert(), "all_weights"_a.noconvert());
  m.def("keep_best", &keep_best_of, "scores"_a, "names"_a, "found"_a, "first"_a, "threads"_a, "isa"_a);
  m.def("code_sums", &code_sums_of, "points"_a, "codes"_a, "threads"_a);
  m.def("pq_encode", &pq_encode_of, "features"_a, "centroids"_a, "threads"_a, "isa"_a);
}
