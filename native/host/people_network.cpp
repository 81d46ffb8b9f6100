#include "host/people_network.h"

namespace drsplat {
namespace {

constexpr float kMost = 6;
constexpr size_t kStep = 16;  // pixels from a place to the next

bool halves(size_t block) { return block == 1 || block == 3 || block == 6; }
size_t reach(size_t block) { return block < 14 ? 1 : 2; }  // pixels from a tap to the next

struct Seeing {
  const Kernels &kernels;
  const std::vector<PhotoLayer> &layers;
  int threads;
  size_t next = 0;

  // A 1x1 convolution of one or two images of one size. bounded: by 0 and 6.
  Planes pointwise(std::initializer_list<const Planes *> inputs, bool bounded, float most = kMost) {
    const Packed layer(layers[next++]);
    const Planes &first = **inputs.begin();
    Planes out(first.height, first.width, layer.outputs);
    over(out, threads, [&](size_t y) {
      ConvolvedRow row = row_of(inputs.begin(), inputs.size(), y, layer, 1);
      row.positive = bounded, row.most = most, row.out = out.row(y, 0);
      kernels.photo->convolve_row(row);
      end_row(out, y);
    });
    return out;
  }

  // Rows that `convolve` writes at the size of the input; of halved images, every second pixel of every second row.
  template <class Convolve>
  Planes rows_of(const Planes &in, size_t channels, bool halved, Convolve convolve) const {
    const size_t step = halved ? 2 : 1;
    Planes out((in.height - 1) / step + 1, (in.width - 1) / step + 1, channels);
    over_rows(out.height, kRows, threads, [&](int, uint64_t begin, uint64_t end) {
      Planes whole(1, in.width, channels);
      for (size_t y = begin; y < end; y++) {
        float *to = halved ? whole.row(0, 0) : out.row(y, 0);
        convolve(step * y, to);
        if (halved)
          for (size_t c = 0; c < channels; c++)
            for (size_t x = 0; x < out.width; x++) out.row(y, c)[x] = whole.row(0, c)[2 * x];
        end_row(out, y);
      }
    });
    return out;
  }

  Planes first(const Planes &photo) {
    const Packed layer(layers[next++]);
    const Planes *input = &photo;
    return rows_of(photo, layer.outputs, true, [&](size_t y, float *out) {
      ConvolvedRow row = row_of(&input, 1, y, layer, 3);
      row.most = kMost, row.out = out;
      kernels.photo->convolve_row(row);
    });
  }

  Planes depthwise(const Planes &in, size_t block) {
    const PhotoLayer &layer = layers[next++];
    return rows_of(in, in.channels, halves(block), [&](size_t y, float *out) {
      kernels.photo->depthwise_row({in.row(y, 0), layer.weights, layer.bias, reach(block), reach(block) * in.row_step(),
                                    in.stride, (uint32_t)in.channels, (uint32_t)(up_to(in.width, kVector) / kVector),
                                    out});
    });
  }

  Planes block(const Planes &in, size_t number) {
    Planes wide;
    if (number) wide = pointwise({&in}, true);
    const Planes seen = depthwise(number ? wide : in, number);
    Planes out = pointwise({&seen}, false);
    if (out.channels == in.channels && out.width == in.width)
      over(out, threads, [&](size_t y) {
        float *to = out.row(y, 0) - kVector;
        const float *from = in.row(y, 0) - kVector;
        for (size_t i = 0; i < out.row_step(); i++) to[i] += from[i];
      });
    return out;
  }

  // Logits of the classes.
  Planes head(const Planes &in) {
    const Planes own = pointwise({&in}, true, INFINITY);
    Planes mean(1, 1, in.channels);
    for (size_t c = 0; c < in.channels; c++) {
      double sum = 0;
      for (size_t y = 0; y < in.height; y++)
        for (size_t x = 0; x < in.width; x++) sum += in.row(y, c)[x];
      mean.row(0, c)[0] = (float)(sum / (double)(in.height * in.width));
    }
    const Planes one = pointwise({&mean}, true, INFINITY);
    Planes everywhere(in.height, in.width, one.channels);
    over(everywhere, threads, [&](size_t y) {
      for (size_t c = 0; c < one.channels; c++) std::fill_n(everywhere.row(y, c), in.width, one.row(0, c)[0]);
    });
    const Planes joined = pointwise({&everywhere, &own}, true, INFINITY);
    return pointwise({&joined}, false);
  }
};

// How much likelier a person is than all else, as a logit at each place.
std::vector<double> odds_of(const Planes &logits) {
  std::vector<double> odds;
  for (size_t y = 0; y < logits.height; y++)
    for (size_t x = 0; x < logits.width; x++) {
      double highest = -INFINITY, sum = 0;
      for (size_t c = 0; c < logits.channels; c++)
        if (c != kPersonClass) highest = std::max(highest, (double)logits.row(y, c)[x]);
      for (size_t c = 0; c < logits.channels; c++)
        if (c != kPersonClass) sum += std::exp(logits.row(y, c)[x] - highest);
      odds.push_back(logits.row(y, kPersonClass)[x] - highest - std::log(sum));
    }
  return odds;
}

}  // namespace

bool fits_people(const std::vector<PhotoLayer> &layers) {
  if (layers.size() != kPeopleLayers) return false;
  size_t channels = 3, next = 0;
  const auto passes = [&](size_t depth) {
    const PhotoLayer &layer = layers[next++];
    channels = layer.outputs;
    return layer.depth == depth && channels > 0 && channels < 4096;
  };
  const auto is_depthwise = [&] {
    const size_t before = channels;
    return passes(9) && channels == before;
  };
  if (!passes(27)) return false;
  for (size_t block = 0; block < kPeopleBlocks; block++)
    if ((block && !passes(channels)) || !is_depthwise() || !passes(channels)) return false;
  const size_t seen = channels;
  if (!passes(seen)) return false;
  const size_t own = channels;
  return passes(seen) && passes(channels + own) && passes(channels) && channels > kPersonClass;
}

void people(const Kernels &kernels, const std::vector<PhotoLayer> &layers, const uint8_t *rgb, size_t height,
            size_t width, int threads, float *likelihoods) {
  Planes photo(height, width, 3);
  for (size_t y = 0; y < height; y++)
    for (size_t x = 0; x < width; x++)
      for (size_t c = 0; c < 3; c++) photo.row(y, c)[x] = (float)(rgb[3 * (y * width + x) + c] - 128) / 128;
  Seeing seeing{kernels, layers, threads};
  Planes seen = seeing.first(photo);
  for (size_t block = 0; block < kPeopleBlocks; block++) seen = seeing.block(seen, block);
  const std::vector<double> odds = odds_of(seeing.head(seen));
  const size_t columns = seen.width;
  over_rows(height, kRows, threads, [&](int, uint64_t begin, uint64_t end) {
    for (size_t y = begin; y < end; y++)
      for (size_t x = 0; x < width; x++) {
        const size_t top = std::min(y / kStep, seen.height - 2 + (seen.height < 2)),
                     left = std::min(x / kStep, columns - 2 + (columns < 2));
        const double down = (double)(y - top * kStep) / kStep, right = (double)(x - left * kStep) / kStep;
        const double *at = odds.data() + top * columns + left;
        const double *below = at + (seen.height > 1 ? columns : 0), *beside = at + (columns > 1);
        const double *across = below + (columns > 1);
        const double odd =
            (1 - down) * ((1 - right) * *at + right * *beside) + down * ((1 - right) * *below + right * *across);
        likelihoods[y * width + x] = (float)(1 / (1 + std::exp(-odd)));
      }
  });
}

}  // namespace drsplat
