// Images of any values of the Gaussians: weighted sums over each pixel's splats.
constexpr int CHANNELS_AT_ONCE = 8;

// values (n, channels). image (height, width, channels), alpha and depth (height, width); depth: weighted mean of
// camera z, 0 where nothing is.
KERNEL __launch_bounds__(256)
    draw(const u32 *starts, const u32 *ids, const Splat *splats, int first_tile, int width, int height, int columns,
         const float *values, int channels, const float *background, float *image, float *alpha, float *depth) {
  __shared__ Batch<256> batch;
  const int tile = first_tile + blockIdx.x;
  const Place place = place_of_thread(tile, columns, width, height);
  const List list = {ids, starts[tile], starts[tile + 1], splats, nullptr, tile, columns};
  const size_t pixel = (size_t)place.y * width + place.x;
  for (int first = 0; first == 0 || first < channels; first += CHANNELS_AT_ONCE) {
    const int n = min(channels - first, CHANNELS_AT_ONCE);
    float total[CHANNELS_AT_ONCE] = {}, weight_sum = 0.f, depth_sum = 0.f;
    const Walked walked = walk(
        batch, list, place, place.inside, 0,
        [&](int j, const Hit &hit) {
          const float *value = values + (size_t)batch.ids[j] * channels + first;
#pragma unroll
          for (int c = 0; c < CHANNELS_AT_ONCE; c++)
            if (c < n) total[c] += hit.weight * value[c];
          weight_sum += hit.weight, depth_sum += hit.weight * batch.splats[j].depth;
        },
        [](u32, u32) {});
    if (place.inside) {
#pragma unroll
      for (int c = 0; c < CHANNELS_AT_ONCE; c++)
        if (c < n) image[pixel * channels + first + c] = total[c] + walked.rest * background[first + c];
      if (first == 0) {
        alpha[pixel] = 1.f - walked.rest;
        depth[pixel] = weight_sum > 0.f ? depth_sum / fmaxf(weight_sum, 1e-30f) : 0.f;
      }
    }
  }
}
