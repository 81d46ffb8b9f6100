#include "bindings/arrays.h"
#include "bindings/module.h"
#include "host/people_network.h"
#include "host/photo_merging.h"
#include "host/photo_network.h"
#include "host/photo_regions.h"
#include "kernels/photo_kernels.h"

#include <cmath>

using namespace drsplat;

namespace {

using Photo = Array<uint8_t, 3>;
using Steps = Array<int32_t, 3>;
using Table = Array<double, 2>;

void require_photo(size_t height, size_t width) {
  require(height > 0 && width > 0 && height < (1u << 16) && width < (1u << 16) && height * width < (1u << 28),
          "1 to 2^28 pixels, fewer than 2^16 to a side");
}

nb::object lab_colors_of(Photo image, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t height = image.shape(0), width = image.shape(1);
  require_photo(height, width), require(image.shape(2) == 3, "an image (H, W, 3)");
  Fresh<int32_t> lab(3 * height * width);
  without_gil([&] { lab_colors(kernels, image.data(), height * width, thread_count(threads), lab.get()); });
  return lab.numpy({height, width, 3});
}

nb::object small_regions_of(Steps lab, double scale, int least) {
  const size_t height = lab.shape(0), width = lab.shape(1);
  require_photo(height, width), require(lab.shape(2) == 3, "colours (H, W, 3)");
  return to_numpy(
      without_gil([&] { return small_regions(lab.data(), (int32_t)height, (int32_t)width, scale, least); }));
}

// Layers of weights and bias in turn, held as long as they are read.
struct HeldLayers {
  std::vector<Rows> weights;
  std::vector<Vector> biases;
  std::vector<PhotoLayer> layers;

  explicit HeldLayers(const nb::tuple &parts) {
    require(parts.size() % 2 == 0 && parts.size() < 1024, "weights and bias of each layer");
    for (size_t i = 0; i < parts.size(); i += 2) {
      weights.push_back(member<Rows>(parts, i, "weights (K, O)"));
      biases.push_back(member<Vector>(parts, i + 1, "a bias (O)"));
      const Rows &w = weights.back();
      require(w.shape(1) == biases.back().shape(0), "a bias for each output");
      layers.push_back({w.data(), biases.back().data(), w.shape(0), w.shape(1)});
    }
  }
};

nb::tuple look_of(Photo image, nb::tuple layers, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t height = image.shape(0), width = image.shape(1);
  require_photo(height, width), require(image.shape(2) == 3, "an image (H, W, 3)");
  require(layers.size() % 8 == 0, "weights and bias of 4 layers for each level");
  const HeldLayers held(layers);
  const PhotoNetwork network{held.layers, (int)(layers.size() / 8)};
  require(fits(network), "layers that fit together");
  Fresh<int32_t> borders(height * width), traits(kTraits * height * width);
  without_gil([&] {
    look(kernels, network, image.data(), (int32_t)height, (int32_t)width, thread_count(threads), borders.get(),
         traits.get());
  });
  return nb::make_tuple(borders.numpy({height, width}), traits.numpy({height, width, kTraits}));
}

nb::object people_of(Photo image, nb::tuple layers, int threads, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const size_t height = image.shape(0), width = image.shape(1);
  require_photo(height, width), require(image.shape(2) == 3, "an image (H, W, 3)");
  require(height % 16 == 1 && width % 16 == 1, "sides that are multiples of 16, and 1 more");
  const HeldLayers held(layers);
  require(fits_people(held.layers), "layers that fit together");
  Fresh<float> likelihoods(height * width);
  without_gil(
      [&] { people(kernels, held.layers, image.data(), height, width, thread_count(threads), likelihoods.get()); });
  return likelihoods.numpy({height, width});
}

nb::object flooded_of(Array<int32_t, 2> heights, Array<int32_t, 2> markers) {
  const size_t height = heights.shape(0), width = heights.shape(1);
  require_photo(height, width);
  require(markers.shape(0) == height && markers.shape(1) == width, "markers (H, W)");
  return to_numpy(
      without_gil([&] { return flooded(heights.data(), markers.data(), (int32_t)height, (int32_t)width); }));
}

nb::tuple photo_graph_of(Array<int32_t, 2> labels, Steps lab, Array<int32_t, 2> borders, Steps traits) {
  const size_t height = labels.shape(0), width = labels.shape(1);
  require_photo(height, width);
  require(lab.shape(0) == height && lab.shape(1) == width && lab.shape(2) == 3, "colours (H, W, 3)");
  require(borders.shape(0) == height && borders.shape(1) == width, "borders (H, W)");
  require(traits.shape(0) == height && traits.shape(1) == width && traits.shape(2) == kTraits, "traits (H, W, 8)");
  const auto [least, most] = std::minmax_element(labels.data(), labels.data() + height * width);
  require(*least >= 0 && (size_t)*most < height * width, "labels from 0, fewer than pixels");
  const SeenPixels seen{labels.data(),   lab.data(),     borders.data(), traits.data(),
                        (int32_t)height, (int32_t)width, *most + 1};
  PhotoGraph graph = without_gil([&] { return photo_graph(seen); });
  return nb::make_tuple(to_numpy(std::move(graph.sums)), to_numpy(std::move(graph.boxes)),
                        to_numpy(std::move(graph.pairs)), to_numpy(std::move(graph.borders)));
}

// sums, boxes, pairs and borders, held as long as they are read.
struct HeldGraph {
  Table sums, boxes, borders;
  Array<int32_t, 2> pairs;
  GivenGraph graph;

  HeldGraph(const nb::tuple &parts, double pixels) {
    require(parts.size() == 4, "a graph of 4 parts");
    sums = member<Table>(parts, 0, "sums of float64"), boxes = member<Table>(parts, 1, "boxes of float64");
    pairs = member<Array<int32_t, 2>>(parts, 2, "pairs of int32"),
    borders = member<Table>(parts, 3, "borders of float64");
    const size_t regions = sums.shape(0), edges = pairs.shape(0);
    require(sums.shape(1) == kRegionColumns && regions < (1u << 28), "sums (N, 55)");
    require(boxes.shape(0) == regions && boxes.shape(1) == 4, "boxes (N, 4)");
    require(pairs.shape(1) == 2 && edges < (1u << 30), "pairs (E, 2)");
    require(borders.shape(0) == edges && borders.shape(1) == kBorderColumns, "borders (E, 5)");
    require_order();
    graph = {sums.data(), boxes.data(), borders.data(), pairs.data(), regions, edges, pixels};
  }

  void require_order() const {
    const int32_t *pair = pairs.data();
    for (size_t e = 0; e < pairs.shape(0); e++, pair += 2) {
      require(pair[0] >= 0 && pair[0] < pair[1] && (size_t)pair[1] < sums.shape(0), "pairs (a, b), a < b < N");
      require(e == 0 || pair[-2] < pair[0] || (pair[-2] == pair[0] && pair[-1] < pair[1]), "pairs in order, each once");
    }
  }
};

// A rule whose units are padded with such as say nothing.
struct HeldRule {
  std::vector<double> center, width, hidden, bias, output;
  PairRule rule;

  HeldRule(const Array<double, 1> &center_of, const Array<double, 1> &width_of, const Table &hidden_of,
           const Array<double, 1> &bias_of, const Array<double, 1> &output_of, double output_bias)
      : center(center_of.data(), center_of.data() + center_of.shape(0)),
        width(width_of.data(), width_of.data() + width_of.shape(0)) {
    const size_t features = hidden_of.shape(0), units = hidden_of.shape(1), padded = (units + 7) / 8 * 8;
    require(features == kPairFeatures && units < (1u << 16), "a rule of 42 features");
    require(center.size() == features && width.size() == features, "center and width of each feature");
    require(bias_of.shape(0) == units && output_of.shape(0) == units, "bias and output of each hidden unit");
    hidden.resize(features * padded), bias.resize(padded), output.resize(padded);
    for (size_t f = 0; f < features; f++)
      std::copy_n(hidden_of.data() + f * units, units, hidden.begin() + (ptrdiff_t)(f * padded));
    std::copy_n(bias_of.data(), units, bias.begin()), std::copy_n(output_of.data(), units, output.begin());
    rule = {center.data(), width.data(), hidden.data(), bias.data(),
            output.data(), output_bias,  kPairFeatures, (uint32_t)padded};
  }
};

HeldRule rule_of(const nb::tuple &parts) {
  require(parts.size() == 6, "a rule of 6 parts");
  const auto vector = [&](size_t place) { return member<Array<double, 1>>(parts, place, "vectors of a rule"); };
  const auto center = vector(0), width = vector(1), bias = vector(3), output = vector(4), last = vector(5);
  require(last.shape(0) == 1, "one bias of the output");
  return HeldRule(center, width, member<Table>(parts, 2, "hidden weights"), bias, output, last.data()[0]);
}

nb::object merged_regions_of(nb::tuple graph, double pixels, nb::tuple rule, double threshold, double least_area,
                             double least_width, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldGraph held(graph, pixels);
  const HeldRule how = rule_of(rule);
  return to_numpy(
      without_gil([&] { return merged_regions(kernels, held.graph, how.rule, {threshold, least_area, least_width}); }));
}

nb::object merge_order_of(nb::tuple graph, double pixels, nb::tuple rule, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldGraph held(graph, pixels);
  const HeldRule how = rule_of(rule);
  return to_numpy(without_gil([&] { return merge_order(kernels, held.graph, how.rule); }));
}

nb::object pair_likelihoods_of(nb::tuple graph, double pixels, nb::tuple rule, const std::string &isa) {
  const Kernels &kernels = kernels_named(isa);
  const HeldGraph held(graph, pixels);
  const HeldRule how = rule_of(rule);
  return to_numpy(without_gil([&] { return pair_likelihoods(kernels, held.graph, how.rule); }));
}

}  // namespace

void bind_photos(nb::module_ &m) {
  m.def("lab_colors", &lab_colors_of, "image"_a, "threads"_a, "isa"_a);
  m.def("small_regions", &small_regions_of, "lab"_a, "scale"_a, "least"_a);
  m.def("look", &look_of, "image"_a, "layers"_a, "threads"_a, "isa"_a);
  m.def("people", &people_of, "image"_a, "layers"_a, "threads"_a, "isa"_a);
  m.def("photo_graph", &photo_graph_of, "labels"_a, "lab"_a, "borders"_a, "traits"_a);
  m.def("merged_regions", &merged_regions_of, "graph"_a, "pixels"_a, "rule"_a, "threshold"_a, "least_area"_a,
        "least_width"_a, "isa"_a);
  m.def("flooded", &flooded_of, "heights"_a, "markers"_a);
  m.def("merge_order", &merge_order_of, "graph"_a, "pixels"_a, "rule"_a, "isa"_a);
  m.def("pair_likelihoods", &pair_likelihoods_of, "graph"_a, "pixels"_a, "rule"_a, "isa"_a);
}
