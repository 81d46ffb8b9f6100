// What follows registration: rows of W @ E, nearest centroids, and scores by table look-up.
#pragma once

constexpr int kColumnParts = kParts == 1 ? 8 : 4;  // sums of 16 columns kept in registers
constexpr int64_t kPartialSum = 32;  // entries added up before they join the total: keeps long rows exact

template <int Parts>
static inline void weighted_columns(const SparseRows &w, int64_t begin, int64_t end, const float *embeddings, size_t dim, float *out) {
  Floats total[Parts];
  for (int p = 0; p < Parts; p++) total[p] = splat(0.f);
  for (int64_t first = begin; first < end; first += kPartialSum) {
    const int64_t last = end - first < kPartialSum ? end : first + kPartialSum;
    Floats partial[Parts];
    for (int p = 0; p < Parts; p++) partial[p] = splat(0.f);
    for (int64_t k = first; k < last; k++) {
      const float *embedding = embeddings + (size_t)w.columns[k] * dim;
      const Floats weight = splat(w.weights[k]);
      for (int p = 0; p < Parts; p++) partial[p] = partial[p] + weight * load(embedding + 16 * p);
    }
    for (int p = 0; p < Parts; p++) total[p] = total[p] + partial[p];
  }
  for (int p = 0; p < Parts; p++) store(out + 16 * p, total[p]);
}

static inline float weighted_column(const SparseRows &w, int64_t begin, int64_t end, const float *embeddings, size_t dim) {
  float total = 0.f;
  for (int64_t first = begin; first < end; first += kPartialSum) {
    const int64_t last = end - first < kPartialSum ? end : first + kPartialSum;
    float partial = 0.f;
    for (int64_t k = first; k < last; k++) partial += w.weights[k] * embeddings[(size_t)w.columns[k] * dim];
    total += partial;
  }
  return total;
}

static inline void normalize(float *row, size_t dim) {
  double lanes[8] = {};
  size_t c = 0;
  for (; c + 8 <= dim; c += 8)
    for (int i = 0; i < 8; i++) lanes[i] += (double)row[c + i] * row[c + i];
  for (int i = 0; c < dim; c++, i++) lanes[i] += (double)row[c] * row[c];
  const double squared = ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
  if (!(squared > 0)) return;
  const double scale = 1 / __builtin_sqrt(squared);
  for (c = 0; c < dim; c++) row[c] = (float)(row[c] * scale);
}

// Rows [begin, end) of W @ E, each divided by its norm. False, with nothing promised about `out`, if an
// entry names no embedding.
static bool weighted_rows(const SparseRows &w, const Embeddings &e, uint64_t begin, uint64_t end, float *out) {
  for (uint64_t i = begin; i < end; i++) {
    const int64_t first = w.starts[i], last = w.starts[i + 1];
    for (int64_t k = first; k < last; k++)
      if ((uint32_t)w.columns[k] >= e.count) return false;
    float *row = out + i * e.dim;
    size_t c = 0;
    for (; c + 16 * kColumnParts <= e.dim; c += 16 * kColumnParts)
      weighted_columns<kColumnParts>(w, first, last, e.values + c, e.dim, row + c);
    for (; c + 16 <= e.dim; c += 16) weighted_columns<1>(w, first, last, e.values + c, e.dim, row + c);
    for (; c < e.dim; c++) row[c] = weighted_column(w, first, last, e.values + c, e.dim);
    normalize(row, e.dim);
  }
  return true;
}

// One row of features per lane, so that the nearest centroid needs no reduction across lanes.
constexpr int kEncodedParts = kParts == 1 ? 2 : 1;

// `subvectors`: dim x (16 * kEncodedParts) floats. Dim 0 means `dim`, known at run time only. The
// difference is squared, not expanded: a feature equal to a centroid is at distance 0 exactly.
template <uint32_t Dim>
static inline void nearest_centroids(const float *subvectors, const float *centroids, uint32_t dim, int32_t *nearest) {
  if (Dim) dim = Dim;
  Floats best[kEncodedParts];
  Ints index[kEncodedParts];
  for (int p = 0; p < kEncodedParts; p++) best[p] = splat(__builtin_inff()), index[p] = splat_int(0);
  for (int32_t c = 0; c < 256; c++, centroids += dim) {
    Floats distance[kEncodedParts];
    for (int p = 0; p < kEncodedParts; p++) distance[p] = splat(0.f);
    for (uint32_t d = 0; d < dim; d++) {
      const Floats centroid = splat(centroids[d]);
      for (int p = 0; p < kEncodedParts; p++) {
        const Floats difference = load(subvectors + 16 * (kEncodedParts * d + p)) - centroid;
        distance[p] = distance[p] + difference * difference;
      }
    }
    for (int p = 0; p < kEncodedParts; p++) {
      index[p] = select(distance[p] < best[p], splat_int(c), index[p]);
      best[p] = minimum(distance[p], best[p]);
    }
  }
  for (int p = 0; p < kEncodedParts; p++) memcpy(nearest + 16 * p, &index[p], sizeof index[p]);
}

// `scratch`: kEncodeScratch * dim floats.
static void pq_encode(const Quantizer &q, const float *features, uint64_t begin, uint64_t end, float *scratch, uint8_t *codes) {
  constexpr int rows = 16 * kEncodedParts;
  static_assert(rows <= (int)kEncodeScratch, "scratch holds every lane");
  const uint32_t dim = q.dim;
  const size_t stride = (size_t)q.subvectors * dim;
  int32_t nearest[rows];
  for (uint64_t first = begin; first < end; first += rows) {
    const uint64_t left = end - first;
    for (uint32_t m = 0; m < q.subvectors; m++) {
      for (int r = 0; r < rows; r++) {
        const uint64_t row = first + ((uint64_t)r < left ? r : left - 1);
        for (uint32_t d = 0; d < dim; d++) scratch[d * rows + r] = features[row * stride + (size_t)m * dim + d];
      }
      const float *centroids = q.centroids + (size_t)m * 256 * dim;
      switch (dim) {
        case 2: nearest_centroids<2>(scratch, centroids, dim, nearest); break;
        case 4: nearest_centroids<4>(scratch, centroids, dim, nearest); break;
        case 8: nearest_centroids<8>(scratch, centroids, dim, nearest); break;
        case 16: nearest_centroids<16>(scratch, centroids, dim, nearest); break;
        default: nearest_centroids<0>(scratch, centroids, dim, nearest);
      }
      for (int r = 0; r < rows && (uint64_t)r < left; r++) codes[(first + r) * q.subvectors + m] = (uint8_t)nearest[r];
    }
  }
}

// Even and odd sub-vectors are summed apart: two chains of additions per row, in one order everywhere.
template <int Rows>
static inline void scan_rows(const Scan &s, uint64_t first, float *scores) {
  const size_t length = s.subvectors;
  float even[Rows] = {}, odd[Rows] = {};
  size_t m = 0;
  for (; m + 8 <= length; m += 8) {
    const float *lut = s.lut + 256 * m;
    for (int r = 0; r < Rows; r++) {
      uint64_t eight;
      memcpy(&eight, s.codes + (first + r) * length + m, 8);
      for (int i = 0; i < 8; i += 2) {
        even[r] += lut[256 * i + (eight >> 8 * i & 255)];
        odd[r] += lut[256 * i + 256 + (eight >> (8 * i + 8) & 255)];
      }
    }
  }
  for (int r = 0; r < Rows; r++) {
    const uint8_t *codes = s.codes + (first + r) * length;
    for (size_t rest = m; rest < length; rest++) (rest % 2 ? odd[r] : even[r]) += s.lut[256 * rest + codes[rest]];
    const float bias = s.bias ? s.bias[first + r] : 0.f;
    scores[first + r] = (bias + (even[r] + odd[r])) * s.scale[first + r];
  }
}

static void pq_scores(const Scan &s, uint64_t begin, uint64_t end, float *scores) {
  for (; begin + 4 <= end; begin += 4) scan_rows<4>(s, begin, scores);
  for (; begin < end; begin++) scan_rows<1>(s, begin, scores);
}
