// The core's Python face: contiguous arrays in, arrays out, the GIL released while working. Shapes are
// checked here only as far as memory safety needs; drsplat.kernels has the friendly messages.
#include "splatting.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <stdexcept>
#include <thread>

namespace nb = nanobind;
using namespace nb::literals;
using namespace drsplat;

namespace {

template <class T, class... Shape>
using Array = nb::ndarray<const T, nb::c_contig, nb::device::cpu, Shape...>;
using Rows = Array<float, nb::ndim<2>>;
using Vector = Array<float, nb::ndim<1>>;

void require(bool ok, const char *what) {
  if (!ok) throw std::invalid_argument(what);
}

template <class T>
nb::object to_numpy(std::vector<T> &&values, std::initializer_list<size_t> shape) {
  auto *owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void *p) noexcept { delete (std::vector<T> *)p; });
  return nb::cast(nb::ndarray<nb::numpy, T>(owned->data(), shape, owner));
}

template <class T>
nb::object to_numpy(std::vector<T> &&values) {
  const size_t n = values.size();
  return to_numpy(std::move(values), {n});
}

const Kernels &kernels_named(const std::string &isa) {
  const Kernels *kernels = find_kernels(isa.c_str());
  if (!kernels) throw std::invalid_argument("instruction set '" + isa + "' is not available on this machine or in this build");
  return *kernels;
}

int thread_count(int threads) { return threads > 0 ? std::min(threads, 256) : std::max(1u, std::thread::hardware_concurrency()); }

Scene scene_of(const Rows &means, const Rows &covariances, const Vector &opacities) {
  const size_t n = opacities.shape(0);
  require(means.shape(0) == 3 && means.shape(1) == n && covariances.shape(0) == 6 && covariances.shape(1) == n, "means (3, N), covariances (6, N), opacities (N)");
  require(n < (1u << 31), "fewer than 2^31 Gaussians");
  return {means.data(), covariances.data(), opacities.data(), (uint32_t)n};
}

// camera: rotation row by row (9), translation (3), fx, fy, cx, cy
Camera camera_of(const Vector &camera, int width, int height) {
  require(camera.shape(0) == 16, "camera: 16 numbers");
  require(width > 0 && height > 0 && width <= 65536 && height <= 65536, "width and height: 1 to 65536");
  Camera c;
  std::copy_n(camera.data(), 9, c.rotation);
  std::copy_n(camera.data() + 9, 3, c.translation);
  c.fx = camera.data()[12], c.fy = camera.data()[13], c.cx = camera.data()[14], c.cy = camera.data()[15];
  c.width = width, c.height = height;
  return c;
}

nb::tuple weights_of_view(Rows means, Rows covariances, Vector opacities, Vector camera, Array<int32_t, nb::ndim<2>> segment_ids, int topk, int first_hits, int threads,
                          const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities);
  const Camera c = camera_of(camera, (int)segment_ids.shape(1), (int)segment_ids.shape(0));
  const Kernels &kernels = kernels_named(isa);
  require(topk >= 0 && first_hits >= 0, "topk and first_hits: 0 or more");
  ViewTriples out;
  StageSeconds s;
  {
    nb::gil_scoped_release release;
    out = view_weights(kernels, scene, c, {topk, first_hits}, segment_ids.data(), thread_count(threads), s);
  }
  return nb::make_tuple(to_numpy(std::move(out.gaussian_ids)), to_numpy(std::move(out.segment_ids)), to_numpy(std::move(out.weights)),
                        nb::make_tuple(s.project, s.sort, s.bin, s.composite, s.merge));
}

nb::tuple contributions_of_view(Rows means, Rows covariances, Vector opacities, Vector camera, int width, int height, int topk, int first_hits, int threads, const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities);
  const Camera c = camera_of(camera, width, height);
  const Kernels &kernels = kernels_named(isa);
  require(topk >= 1 && first_hits >= 0, "topk: 1 or more; first_hits: 0 or more");
  const size_t h = height, w = width, k = topk;
  std::vector<int32_t> ids(h * w * k, -1);
  std::vector<float> weights(h * w * k, 0.f);
  {
    nb::gil_scoped_release release;
    topk_contributions(kernels, scene, c, {topk, first_hits}, thread_count(threads), ids.data(), weights.data());
  }
  return nb::make_tuple(to_numpy(std::move(ids), {h, w, k}), to_numpy(std::move(weights), {h, w, k}));
}

nb::tuple render_view(Rows means, Rows covariances, Vector opacities, Vector camera, int width, int height, Rows values, Vector background, int threads, const std::string &isa) {
  const Scene scene = scene_of(means, covariances, opacities);
  const Camera c = camera_of(camera, width, height);
  const Kernels &kernels = kernels_named(isa);
  require(values.shape(0) == scene.count && background.shape(0) == values.shape(1), "values (N, C), background (C)");
  const size_t h = height, w = width, channels = values.shape(1);
  std::vector<float> image(h * w * channels), alpha(h * w), depth(h * w);
  {
    nb::gil_scoped_release release;
    render(kernels, scene, c, values.data(), (int32_t)channels, background.data(), thread_count(threads), image.data(), alpha.data(), depth.data());
  }
  return nb::make_tuple(to_numpy(std::move(image), {h, w, channels}), to_numpy(std::move(alpha), {h, w}), to_numpy(std::move(depth), {h, w}));
}

nb::object colors_of(Array<float, nb::ndim<3>> sh, Rows means, Vector center, int threads, const std::string &isa) {
  const size_t n = means.shape(0), k = sh.shape(1);
  require(sh.shape(0) == n && sh.shape(2) == 3 && means.shape(1) == 3 && center.shape(0) == 3, "sh (N, K, 3), means (N, 3), center (3)");
  require(k == 1 || k == 4 || k == 9 || k == 16, "sh: 1, 4, 9 or 16 coefficients");
  const Kernels &kernels = kernels_named(isa);
  std::vector<float> colors(n * 3);
  {
    nb::gil_scoped_release release;
    sh_colors(kernels, sh.data(), (int32_t)k, means.data(), center.data(), (uint32_t)n, thread_count(threads), colors.data());
  }
  return to_numpy(std::move(colors), {n, 3});
}

}  // namespace

void bind_algebra(nb::module_ &m);

NB_MODULE(_native, m) {
  bind_algebra(m);
  m.def("available_isas", [] {
    nb::list names;
    for (auto list = available_kernels(); *list; list++) names.append((*list)->name);
    return names;
  });
  m.def("view_weights", &weights_of_view, "means"_a, "covariances"_a, "opacities"_a, "camera"_a, "segment_ids"_a, "topk"_a, "first_hits"_a, "threads"_a, "isa"_a);
  m.def("topk_contributions", &contributions_of_view, "means"_a, "covariances"_a, "opacities"_a, "camera"_a, "width"_a, "height"_a, "topk"_a, "first_hits"_a, "threads"_a, "isa"_a);
  m.def("render", &render_view, "means"_a, "covariances"_a, "opacities"_a, "camera"_a, "width"_a, "height"_a, "values"_a, "background"_a, "threads"_a, "isa"_a);
  m.def("sh_colors", &colors_of, "sh"_a, "means"_a, "center"_a, "threads"_a, "isa"_a);
}
