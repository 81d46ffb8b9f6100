#include "host/splatting.h"
#include "bindings/arrays.h"
#include "bindings/module.h"
#include "host/labels.h"

using namespace drsplat;

namespace {

Scene scene_of(const Rows &means, const Rows &covariances, const Vector &opacities, bool antialiased) {
  const size_t n = opacities.shape(0);
  require(means.shape(0) == 3 && means.shape(1) == n && covariances.shape(0) == 6 && covariances.shape(1) == n,
          "means (3, N), covariances (6, N), opacities (N)");
  require(n < (1u << 31), "fewer than 2^31 Gaussians");
  return {means.data(), covariances.data(), opacities.data(), (uint32_t)n, antialiased};
}

nb::tuple weights_of_view(Rows means, Rows covariances, Vector opacities, bool antialiased, Vector camera,
                          Array<int32_t, 2> segment_ids, int topk, int first_hits, int threads,
                          const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities, antialiased);
  const Camera c = camera_of(camera, (int)segment_ids.shape(1), (int)segment_ids.shape(0));
  const Kernels &kernels = kernels_named(isa);
  require(topk >= 0 && first_hits >= 0, "topk and first_hits: 0 or more");
  StageSeconds s;
  ViewTriples out = without_gil([&] {
    return view_weights(kernels, scene, c, {topk, first_hits}, segment_ids.data(), thread_count(threads), s);
  });
  return nb::make_tuple(to_numpy(std::move(out.gaussian_ids)), to_numpy(std::move(out.segment_ids)),
                        to_numpy(std::move(out.weights)),
                        nb::make_tuple(s.project, s.sort, s.bin, s.composite, s.merge));
}

nb::tuple contributions_of_view(Rows means, Rows covariances, Vector opacities, bool antialiased, Vector camera,
                                int width, int height, int topk, int first_hits, int threads, const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities, antialiased);
  const Camera c = camera_of(camera, width, height);
  const Kernels &kernels = kernels_named(isa);
  require(topk >= 1 && first_hits >= 0, "topk: 1 or more; first_hits: 0 or more");
  const size_t h = height, w = width, k = topk;
  Fresh<int32_t> ids(h * w * k, -1);
  Fresh<float> weights(h * w * k, 0.f);
  without_gil([&] {
    topk_contributions(kernels, scene, c, {topk, first_hits}, thread_count(threads), ids.get(), weights.get());
  });
  return nb::make_tuple(ids.numpy({h, w, k}), weights.numpy({h, w, k}));
}

nb::object labels_of_pixels(Array<int32_t, 3> ids, Array<float, 3> weights, Array<int32_t, 1> labels, int threads) {
  const size_t h = ids.shape(0), w = ids.shape(1);
  require(ids.shape(2) == kHeaviest && weights.shape(0) == h && weights.shape(1) == w && weights.shape(2) == kHeaviest,
          "ids and weights (h, w, 8)");
  Fresh<int32_t> found(h * w);
  const bool ok = without_gil([&] {
    return heaviest_labels(ids.data(), weights.data(), h * w, labels.data(), labels.shape(0), thread_count(threads),
                           found.get());
  });
  require(ok, "ids of Gaussians with a label");
  return found.numpy({h, w});
}

nb::tuple render_view(Rows means, Rows covariances, Vector opacities, bool antialiased, Vector camera, int width,
                      int height, Rows values, Vector background, int threads, const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities, antialiased);
  const Camera c = camera_of(camera, width, height);
  const Kernels &kernels = kernels_named(isa);
  require(values.shape(0) == scene.count && background.shape(0) == values.shape(1), "values (N, C), background (C)");
  const size_t h = height, w = width, channels = values.shape(1);
  Fresh<float> image(h * w * channels), alpha(h * w), depth(h * w);
  without_gil([&] {
    render(kernels, scene, c, values.data(), (int32_t)channels, background.data(), thread_count(threads), image.get(),
           alpha.get(), depth.get());
  });
  return nb::make_tuple(image.numpy({h, w, channels}), alpha.numpy({h, w}), depth.numpy({h, w}));
}

nb::object colors_of(Array<float, 3> sh, Rows means, Vector center, int threads, const std::string &isa) {
  const size_t n = means.shape(0), k = sh.shape(1);
  require_sh(sh, n);
  require(means.shape(1) == 3 && center.shape(0) == 3, "means (N, 3), center (3)");
  const Kernels &kernels = kernels_named(isa);
  Fresh<float> colors(n * 3);
  without_gil([&] {
    sh_colors(kernels, sh.data(), (int32_t)k, means.data(), center.data(), (uint32_t)n, thread_count(threads),
              colors.get());
  });
  return colors.numpy({n, 3});
}

}  // namespace

void bind_splatting(nb::module_ &m) {
  m.def("view_weights", &weights_of_view, "means"_a, "covariances"_a, "opacities"_a, "antialiased"_a, "camera"_a,
        "segment_ids"_a, "topk"_a, "first_hits"_a, "threads"_a, "isa"_a);
  m.def("release_workspaces", &release_idle);
  m.def("topk_contributions", &contributions_of_view, "means"_a, "covariances"_a, "opacities"_a, "antialiased"_a,
        "camera"_a, "width"_a, "height"_a, "topk"_a, "first_hits"_a, "threads"_a, "isa"_a);
  m.def("heaviest_labels", &labels_of_pixels, "ids"_a, "weights"_a, "labels"_a, "threads"_a);
  m.def("render", &render_view, "means"_a, "covariances"_a, "opacities"_a, "antialiased"_a, "camera"_a, "width"_a,
        "height"_a, "values"_a, "background"_a, "threads"_a, "isa"_a);
  m.def("sh_colors", &colors_of, "sh"_a, "means"_a, "center"_a, "threads"_a, "isa"_a);
}
