#include "host/scan.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

using namespace drsplat;

namespace {

using Codes = Array<uint8_t, 3>;
using Ids = Array<uint16_t, 1>;
using Luts = Array<float, 3>;

struct Asked {
  Codes codes;  // these five hold what is pointed into
  Vector norms;
  std::optional<Ids> ids;
  Luts luts;
  std::optional<Rows> coarse;
  const ScanKernels &kernels;
  GroupedRows rows;
  QueryTables tables;
  Precision precision;
  int threads;
};

// rows: codes (groups, L, 256), inverse norms (n), coarse ids (n) or None. tables: (Q, L, 256), (Q, C) or None.
// how: error, wide, threads, isa.
Asked asked_of(const nb::tuple &rows, const nb::tuple &tables, const nb::tuple &how) {
  require(rows.size() == 3 && tables.size() == 2 && how.size() == 4,
          "(codes, norms, ids), (luts, coarse), (error, wide, threads, isa)");
  const auto codes = member<Codes>(rows, 0, "codes (groups, L, 256) of bytes");
  const auto norms = member<Vector>(rows, 1, "inverse norms (n) of float32");
  const auto ids = member<std::optional<Ids>>(rows, 2, "coarse ids (n) of uint16, or None");
  const auto luts = member<Luts>(tables, 0, "tables (Q, L, 256) of float32");
  const auto coarse = member<std::optional<Rows>>(tables, 1, "coarse tables (Q, C) of float32, or None");
  const size_t n = norms.shape(0), subvectors = codes.shape(1), queries = luts.shape(0);
  require(codes.shape(2) == kGroupRows && codes.shape(0) == (n + kGroupRows - 1) / kGroupRows,
          "codes (ceil(n / 256), L, 256) for n inverse norms");
  require(subvectors > 0 && subvectors < (1u << 16) && luts.shape(1) == subvectors && luts.shape(2) == 256,
          "tables (Q, L, 256), 0 < L < 65536");
  require(queries > 0 && queries <= (1u << 16), "1 to 65536 queries");
  require(bool(ids) == bool(coarse), "coarse ids and coarse tables together");
  require(!ids || (ids->shape(0) == n && coarse->shape(0) == queries && coarse->shape(1) < (1u << 17)),
          "a coarse id per row and a coarse table per query");
  const float error = member<float>(how, 0, "an error above 0");
  require(error > 0, "an error above 0");
  return {codes,
          norms,
          ids,
          luts,
          coarse,
          *kernels_named(member<std::string>(how, 3, "the name of an instruction set")).scan,
          {codes.data(), norms.data(), ids ? ids->data() : nullptr, n, (uint32_t)subvectors},
          {luts.data(), coarse ? coarse->data() : nullptr, (uint32_t)queries, coarse ? (uint32_t)coarse->shape(1) : 0},
          {error, member<uint32_t>(how, 1, "how many tables are wide")},
          thread_count(member<int>(how, 2, "a number of threads"))};
}

nb::object scores_of(const nb::tuple &rows, const nb::tuple &tables, const nb::tuple &how) {
  const Asked a = asked_of(rows, tables, how);
  Fresh<float> scores(a.tables.queries * a.rows.rows);
  without_gil([&] { scan_scores(a.kernels, a.rows, a.tables, a.precision, a.threads, scores.get()); });
  return scores.numpy({a.tables.queries, a.rows.rows});
}

nb::tuple above_of(const nb::tuple &rows, const nb::tuple &tables, const nb::tuple &how, float threshold,
                   std::optional<Vector> floor) {
  const Asked a = asked_of(rows, tables, how);
  require(a.tables.queries == 1 && (!floor || floor->shape(0) == a.rows.rows), "one query, and a floor per row");
  return rows_and_scores(without_gil([&] {
    return scan_above(a.kernels, a.rows, a.tables, a.precision, floor ? floor->data() : nullptr, threshold, a.threads);
  }));
}

nb::tuple top_of(const nb::tuple &rows, const nb::tuple &tables, const nb::tuple &how, uint32_t count) {
  const Asked a = asked_of(rows, tables, how);
  require(a.tables.queries == 1 && count > 0, "one query, and a count above 0");
  return rows_and_scores(
      without_gil([&] { return scan_top(a.kernels, a.rows, a.tables, a.precision, count, a.threads); }));
}

nb::tuple best_of(const nb::tuple &rows, const nb::tuple &tables, const nb::tuple &how) {
  const Asked a = asked_of(rows, tables, how);
  const size_t n = a.rows.rows;
  Fresh<int32_t> winner(n);
  Fresh<float> best(n), runner_up(n);
  without_gil([&] {
    scan_best(a.kernels, a.rows, a.tables, a.precision, a.threads, winner.get(), best.get(), runner_up.get());
  });
  return nb::make_tuple(winner.numpy({n}), best.numpy({n}), runner_up.numpy({n}));
}

nb::object lookup_tables_of(Array<float, 3> centroids, Rows queries, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t subvectors = centroids.shape(0), dim = centroids.shape(1), count = queries.shape(0);
  require(centroids.shape(2) == 256 && subvectors > 0 && dim > 0 && subvectors * dim == queries.shape(1) &&
              subvectors < (1u << 24) && dim < (1u << 24) && count < (1u << 24),
          "centroids (L, D / L, 256) and queries (Q, D)");
  Fresh<float> tables(count * subvectors * 256);
  without_gil([&] {
    lookup_tables(*kernels.scan, centroids.data(), queries.data(), (uint32_t)count, (uint32_t)subvectors, (uint32_t)dim,
                  thread_count(threads), tables.get());
  });
  return tables.numpy({count, subvectors, 256});
}

}  // namespace

void bind_scan(nb::module_ &m) {
  m.def("scan_scores", &scores_of, "rows"_a, "tables"_a, "how"_a);
  m.def("scan_above", &above_of, "rows"_a, "tables"_a, "how"_a, "threshold"_a, "floor"_a.none());
  m.def("scan_top", &top_of, "rows"_a, "tables"_a, "how"_a, "count"_a);
  m.def("scan_best", &best_of, "rows"_a, "tables"_a, "how"_a);
  m.def("lookup_tables", &lookup_tables_of, "centroids"_a, "queries"_a, "threads"_a, "isa"_a);
}
