#include "host/mixture.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

using namespace drsplat;

namespace {

using Bytes = Array<int8_t, 2>;

Atoms atoms_of(const Bytes &values, const Vector &scales) {
  require(scales.shape(0) == values.shape(0), "one scale per atom");
  require(values.shape(0) < (1u << 31) && values.shape(1) >= 1 && values.shape(1) <= 65536,
          "fewer than 2^31 atoms of 1 to 65,536 numbers");
  return {values.data(), scales.data(), (uint32_t)values.shape(0), (uint32_t)values.shape(1)};
}

bool within(const int32_t *ids, size_t count, size_t limit) {
  for (size_t i = 0; i < count; i++)
    if ((uint32_t)ids[i] >= limit) return false;
  return true;
}

nb::tuple mixture_encode_of(Bytes values, Vector scales, Rows features, Array<int64_t, 1> starts,
                            Array<int32_t, 1> columns, Array<int32_t, 2> further, int wanted, int threads,
                            const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const Atoms atoms = atoms_of(values, scales);
  const size_t rows = features.shape(0), k = wanted;
  require(features.shape(1) == atoms.dim && starts.shape(0) == rows + 1 && further.shape(0) == rows &&
              further.shape(1) <= kMostWanted,
          "features (b, D), starts (b + 1), further (b, up to 64)");
  require(wanted >= 1 && wanted <= kMostAtoms, "1 to 16 atoms per row");
  require_starts(starts, columns.shape(0));
  require(within(columns.data(), columns.shape(0), atoms.count) && within(further.data(), further.size(), atoms.count),
          "candidates that are existing atoms");
  Fresh<int32_t> ids(rows * k);
  Fresh<uint8_t> weights(rows * k);
  Fresh<float> row_scales(rows);
  const MixtureSource source = {
      features.data(), starts.data(), columns.data(), further.data(), (uint32_t)further.shape(1), (uint32_t)wanted};
  without_gil([&] {
    mixture_encode(kernels, atoms, source, rows, thread_count(threads), {ids.get(), weights.get(), row_scales.get()});
  });
  return nb::make_tuple(ids.numpy({rows, k}), weights.numpy({rows, k}), row_scales.numpy({rows}));
}

nb::object nearest_centres_of(Rows points, Rows centres, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t rows = points.shape(0), dim = points.shape(1);
  require(centres.shape(1) == dim && dim >= 1 && dim <= 65536 && centres.shape(0) >= 1 && centres.shape(0) < (1u << 31),
          "centres (C, D) for points (n, D)");
  Fresh<int32_t> nearest(rows);
  without_gil([&] {
    nearest_centres(kernels, {centres.data(), (uint32_t)centres.shape(0), (uint32_t)dim}, points.data(), rows,
                    thread_count(threads), nearest.get());
  });
  return nearest.numpy({rows});
}

nb::object nearest_members_of(Bytes values, Vector scales, Rows points, Array<int32_t, 1> groups,
                              Array<int32_t, 2> members, int wanted, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const Atoms atoms = atoms_of(values, scales);
  const size_t rows = points.shape(0), k = wanted;
  require(points.shape(1) == atoms.dim && groups.shape(0) == rows, "points (n, D) and one group each");
  require(wanted >= 1 && wanted <= (int)kMostWanted && members.shape(1) >= k && members.shape(1) < (1u << 31),
          "as many members as are wanted, up to 64");
  require(within(groups.data(), rows, members.shape(0)) && within(members.data(), members.size(), atoms.count),
          "groups and members that exist");
  Fresh<int32_t> nearest(rows * k);
  without_gil([&] {
    nearest_members(kernels, atoms, {groups.data(), members.data(), (uint32_t)members.shape(1), (uint32_t)wanted},
                    points.data(), rows, thread_count(threads), nearest.get());
  });
  return nearest.numpy({rows, k});
}

// A code as Python holds it: ids, weights, scales, atom values, atom scales. An id that no atom has counts as an atom
// of score 0: nothing need be read to know that a scan is safe.
struct HeldCode {
  Array<uint16_t, 3> ids;
  Array<uint8_t, 3> weights;
  Array<uint16_t, 1> scales;
  Bytes values;
  Vector atom_scales;

  explicit HeldCode(const nb::tuple &parts) {
    require(parts.size() == 5, "ids, weights, scales, atom values, atom scales");
    ids = member<Array<uint16_t, 3>>(parts, 0, "ids of uint16");
    weights = member<Array<uint8_t, 3>>(parts, 1, "weights of bytes");
    scales = member<Array<uint16_t, 1>>(parts, 2, "scales of half floats, as uint16");
    values = member<Bytes>(parts, 3, "atoms of signed bytes");
    atom_scales = member<Vector>(parts, 4, "scales of atoms of float32");
  }
  MixtureCode code() const {
    const size_t rows = scales.shape(0), blocks = (rows + kMixtureBlock - 1) / kMixtureBlock, per_row = ids.shape(1);
    require(ids.shape(0) == blocks && ids.shape(2) == kMixtureBlock && per_row >= 1 && per_row <= kMostAtoms,
            "ids (blocks, K, 64)");
    for (int i = 0; i < 3; i++) require(weights.shape(i) == ids.shape(i), "weights as ids");
    const Atoms atoms = atoms_of(values, atom_scales);
    require(atoms.count <= 65536, "up to 65,536 atoms");
    return {{ids.data(), weights.data(), scales.data(), (uint32_t)per_row}, rows, atoms};
  }
};

MixtureQueries queries_of(const Rows &queries, const MixtureCode &code) {
  require(queries.shape(1) == code.atoms.dim && queries.shape(0) < (1u << 31), "queries (Q, D)");
  return {queries.data(), (uint32_t)queries.shape(0)};
}

nb::object mixture_scores_of(const nb::tuple &parts, Rows queries, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldCode held(parts);
  const MixtureCode code = held.code();
  const MixtureQueries given = queries_of(queries, code);
  Fresh<float> scores(given.count * code.rows);
  without_gil([&] { mixture_scores(kernels, code, given, thread_count(threads), scores.get()); });
  return scores.numpy({given.count, code.rows});
}

nb::tuple mixture_select_of(const nb::tuple &parts, Vector query, float threshold, std::optional<Vector> floor,
                            int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldCode held(parts);
  const MixtureCode code = held.code();
  require(query.shape(0) == code.atoms.dim && (!floor || floor->shape(0) == code.rows), "query (D), floor one per row");
  return rows_and_scores(without_gil([&] {
    return mixture_select(kernels, code, query.data(), threshold, floor ? floor->data() : nullptr,
                          thread_count(threads));
  }));
}

nb::tuple mixture_top_of(const nb::tuple &parts, Vector query, uint64_t count, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldCode held(parts);
  const MixtureCode code = held.code();
  require(query.shape(0) == code.atoms.dim, "query (D)");
  return rows_and_scores(
      without_gil([&] { return mixture_top(kernels, code, query.data(), count, thread_count(threads)); }));
}

nb::tuple mixture_best_of(const nb::tuple &parts, Rows queries, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldCode held(parts);
  const MixtureCode code = held.code();
  const MixtureQueries given = queries_of(queries, code);
  require(given.count >= 1, "a query");
  Fresh<int32_t> index(code.rows);
  Fresh<float> scores(code.rows), runner_up(code.rows);
  without_gil(
      [&] { mixture_best(kernels, code, given, thread_count(threads), {index.get(), scores.get(), runner_up.get()}); });
  return nb::make_tuple(index.numpy({code.rows}), scores.numpy({code.rows}), runner_up.numpy({code.rows}));
}

}  // namespace

void bind_mixture(nb::module_ &m) {
  m.def("mixture_encode", &mixture_encode_of, "values"_a, "scales"_a, "features"_a, "starts"_a, "columns"_a,
        "further"_a, "wanted"_a, "threads"_a, "isa"_a);
  m.def("nearest_centres", &nearest_centres_of, "points"_a, "centres"_a, "threads"_a, "isa"_a);
  m.def("nearest_members", &nearest_members_of, "values"_a, "scales"_a, "points"_a, "groups"_a, "members"_a, "wanted"_a,
        "threads"_a, "isa"_a);
  m.def("mixture_scores", &mixture_scores_of, "parts"_a, "queries"_a, "threads"_a, "isa"_a);
  m.def("mixture_select", &mixture_select_of, "parts"_a, "query"_a, "threshold"_a, "floor"_a.none(), "threads"_a,
        "isa"_a);
  m.def("mixture_top", &mixture_top_of, "parts"_a, "query"_a, "count"_a, "threads"_a, "isa"_a);
  m.def("mixture_best", &mixture_best_of, "parts"_a, "queries"_a, "threads"_a, "isa"_a);
}
