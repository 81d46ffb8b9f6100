#include "host/boxes.h"
#include "bindings/arrays.h"
#include "bindings/module.h"

using namespace drsplat;

namespace {

nb::tuple boxes_of(Rows means, Rows quats, Rows scales, Vector mass, Array<int64_t, 1> starts, Array<int64_t, 1> ids,
                   std::optional<Array<double, 1>> up, double outliers, double strays, double sparse, int threads) {
  const size_t count = mass.shape(0);
  require(means.shape(0) == count && means.shape(1) == 3, "means (N, 3)");
  require(quats.shape(0) == count && quats.shape(1) == 4, "quats (N, 4)");
  require(scales.shape(0) == count && scales.shape(1) == 3, "scales (N, 3)");
  require(!up || up->shape(0) == 3, "up: 3 numbers");
  require_starts(starts, ids.shape(0));
  const size_t sets = starts.shape(0) - 1;
  for (size_t s = 0; s < sets; s++) require(starts.data()[s] < starts.data()[s + 1], "sets of at least one");
  for (size_t i = 0; i < ids.shape(0); i++)
    require(ids.data()[i] >= 0 && (size_t)ids.data()[i] < count, "ids of existing Gaussians");
  Fresh<double> centers(3 * sets), axes(9 * sets), lengths(3 * sets);
  const BoxRule rule{outliers, strays, sparse, up ? up->data() : nullptr};
  without_gil([&] {
    boxes({means.data(), quats.data(), scales.data(), mass.data()}, starts.data(), ids.data(), sets, rule,
          thread_count(threads), centers.get(), axes.get(), lengths.get());
    return 0;
  });
  return nb::make_tuple(centers.numpy({sets, 3}), axes.numpy({sets, 3, 3}), lengths.numpy({sets, 3}));
}

}  // namespace

void bind_boxes(nb::module_ &m) {
  m.def("boxes", &boxes_of, "means"_a, "quats"_a, "scales"_a, "mass"_a, "starts"_a, "ids"_a, "up"_a.none(),
        "outliers"_a, "strays"_a, "sparse"_a, "threads"_a);
}
