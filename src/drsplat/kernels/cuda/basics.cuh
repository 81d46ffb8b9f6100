// What all kernels share: names of types, and the few operations whose rounding must not depend on a compiler.
//
// The sources are compiled on the user's machine, for its GPU, by NVRTC (engine.py joins the files in order); the tests
// compile them for the CPU, where threads of a block take turns (tests/cuda_on_cpu).
typedef unsigned int u32;
typedef unsigned long long u64;
typedef long long i64;
typedef unsigned char u8;

#define DEVICE static __device__ __forceinline__
#define DEVICE_MEMBER __device__ __forceinline__
#define KERNEL extern "C" __global__ void
#define FULL 0xffffffffu  // all lanes of a warp

constexpr float MIN_ALPHA = 1.f / 255, BLUR = 0.3f, LOG2_E = 1.44269504f;
constexpr float LOG2_MIN_ALPHA = -7.99435344f, MIN_TRANSMITTANCE = 1e-4f, MAX_ALPHA = 0.99f;
constexpr float CULL_SLACK = 1e-4f;  // keeps every cull on the safe side of float rounding
constexpr int TILE = 16;             // pixels a side

struct Camera {  // see splats.py: camera_numbers, then the centre in the world
  float rotation[9], translation[3];  // x_cam = rotation * x_world + translation
  float fx, fy, cx, cy;
  float near_z;  // camera z up to which nothing is drawn
  float center[3];
};

DEVICE float clampf(float a, float low, float high) { return fminf(fmaxf(a, low), high); }
DEVICE int lane_of_warp() { return threadIdx.x & 31; }
DEVICE int warp_of_block() { return threadIdx.x >> 5; }

// The sum over all lanes, in every lane, in a fixed order.
DEVICE float warp_sum(float a) {
  for (int step = 16; step; step >>= 1) a += __shfl_xor_sync(FULL, a, step);
  return a;
}
DEVICE double warp_sum_double(double a) {
  for (int step = 16; step; step >>= 1) a += __shfl_xor_sync(FULL, a, step);
  return a;
}

#ifndef DYNAMIC_SHARED
#define DYNAMIC_SHARED(type, name) extern __shared__ type name[]
#endif
