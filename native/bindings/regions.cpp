#include "host/regions.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

#include <cmath>

using namespace drsplat;

namespace {

void require_votes(const Array<int64_t, 1> &starts, const Array<int32_t, 1> &columns, const Array<int32_t, 1> &views) {
  require_starts(starts, columns.shape(0));
  const size_t rows = starts.shape(0) - 1;
  for (size_t r = 0; r < rows; r++)
    for (int64_t e = starts.data()[r]; e < starts.data()[r + 1]; e++) {
      const int32_t column = columns.data()[e];
      require(column >= 0 && (size_t)column < views.shape(0), "columns of existing masks");
      require(e == starts.data()[r] || columns.data()[e - 1] < column, "columns that ascend in each row");
    }
  for (size_t m = 1; m < views.shape(0); m++)
    require(views.data()[m - 1] <= views.data()[m], "masks in the order of their views");
}

const Edge *edges_of(const Array<int32_t, 2> &pairs, size_t rows) {
  static_assert(sizeof(Edge) == 2 * sizeof(int32_t), "pairs of numbers");
  require(pairs.shape(1) == 2 && pairs.shape(0) <= UINT32_MAX, "edges (E, 2), fewer than 2^32");
  const auto *edges = reinterpret_cast<const Edge *>(pairs.data());
  for (size_t e = 0; e < pairs.shape(0); e++)
    require(edges[e].a >= 0 && edges[e].a < edges[e].b && (size_t)edges[e].b < rows, "edges (a, b), a < b < rows");
  return edges;
}

// The views from 0, without gaps.
std::vector<int32_t> numbered(const Array<int32_t, 1> &views) {
  std::vector<int32_t> numbers(views.shape(0));
  for (size_t m = 1; m < numbers.size(); m++) numbers[m] = numbers[m - 1] + (views.data()[m] != views.data()[m - 1]);
  return numbers;
}

// rule: the numbers of MergeRule in their order.
MergeRule rule_of(const Array<double, 1> &rule) {
  require(rule.shape(0) == 11, "rule: 11 numbers");
  const double *r = rule.data();
  for (int i = 0; i < 11; i++) require(std::isfinite(r[i]) && r[i] >= 0 && r[i] < 1e9, "rule: numbers of 0 or more");
  require(r[0] > 0 && r[1] > 0 && r[4] > 0 && r[6] > 0, "rule: soft, far, least and unit above 0");
  return {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], (int)std::min(r[8], 1000.0), (int64_t)r[9], r[10]};
}

nb::tuple agglomerate_of(Array<int64_t, 1> order, Array<int64_t, 1> starts, Array<int32_t, 1> columns, Vector weights,
                         Array<int32_t, 1> views, Rows embeddings, Array<int32_t, 2> edges, Array<double, 1> thresholds,
                         Array<double, 1> rule, int threads) {
  require(starts.shape(0) >= 1 && starts.shape(0) < (1u << 30), "starts (rows + 1), fewer than 2^30");
  require(columns.shape(0) == weights.shape(0), "columns and weights of one length");
  require(views.shape(0) == embeddings.shape(0) && views.shape(0) < (1u << 31), "one view and embedding per mask");
  require(embeddings.shape(1) < (1u << 16), "embeddings of fewer than 2^16 numbers");
  require_votes(starts, columns, views);
  const size_t rows = starts.shape(0) - 1;
  require(order.shape(0) == rows, "order: a number of each row");
  for (size_t r = 0; r < rows; r++)
    require(order.data()[r] >= 0 && (size_t)order.data()[r] < rows, "order: numbers of rows");
  const std::vector<int32_t> numbers = numbered(views);
  const Votes votes = {order.data(),   starts.data(),     columns.data(),
                       weights.data(), (uint32_t)rows,    (uint32_t)views.shape(0),
                       numbers.data(), embeddings.data(), (uint32_t)embeddings.shape(1)};
  const MergeRule how = rule_of(rule);
  const Edge *pairs = edges_of(edges, rows);
  const size_t num_edges = edges.shape(0);
  const std::vector<double> levels(thresholds.data(), thresholds.data() + thresholds.shape(0));
  Forest forest = without_gil([&] { return agglomerate(votes, pairs, num_edges, levels, how, thread_count(threads)); });
  return nb::make_tuple(to_numpy(std::move(forest.parents)), to_numpy(std::move(forest.agreements)),
                        to_numpy(std::move(forest.sizes)), to_numpy(std::move(forest.masses)),
                        to_numpy(std::move(forest.fits)), to_numpy(std::move(forest.spreads)));
}

}  // namespace

void bind_regions(nb::module_ &m) {
  m.def("agglomerate", &agglomerate_of, "order"_a, "starts"_a, "columns"_a, "weights"_a, "views"_a, "embeddings"_a,
        "edges"_a, "thresholds"_a, "rule"_a, "threads"_a);
}
