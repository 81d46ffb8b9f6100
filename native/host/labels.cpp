#include "host/labels.h"

#include "host/parallel.h"

#include <atomic>

namespace drsplat {
namespace {

float total_of(int32_t label, const int32_t *labels, const float *weights) {
  float shares[kHeaviest];
  for (size_t i = 0; i < kHeaviest; i++) shares[i] = labels[i] == label ? weights[i] : 0;
  return ((shares[0] + shares[1]) + (shares[2] + shares[3])) + ((shares[4] + shares[5]) + (shares[6] + shares[7]));
}

int32_t heaviest(const int32_t *labels, const float *weights) {
  int32_t best = labels[0];
  float most = total_of(best, labels, weights);
  for (size_t i = 1; i < kHeaviest; i++) {
    if (labels[i] == labels[i - 1]) continue;
    const float total = total_of(labels[i], labels, weights);
    if (total > most) most = total, best = labels[i];
  }
  return best;
}

}  // namespace

bool heaviest_labels(const int32_t *ids, const float *weights, size_t pixels, const int32_t *labels, size_t gaussians,
                     int threads, int32_t *found) {
  std::atomic<bool> ok{true};
  over_rows(pixels, 4096, threads, [&](int, uint64_t begin, uint64_t end) {
    for (uint64_t pixel = begin; pixel < end; pixel++) {
      int32_t seen[kHeaviest];
      for (size_t i = 0; i < kHeaviest; i++) {
        const int32_t id = ids[kHeaviest * pixel + i];
        if (id >= 0 && (size_t)id >= gaussians) ok = false;
        seen[i] = id >= 0 && (size_t)id < gaussians ? labels[id] : -1;
      }
      found[pixel] = heaviest(seen, weights + kHeaviest * pixel);
    }
  });
  return ok;
}

}  // namespace drsplat
