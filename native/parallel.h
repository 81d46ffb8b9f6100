// Threads for one call: started and joined inside it, so forking and calling from many threads are safe.
#pragma once
#include <cstdint>
#include <exception>
#include <thread>
#include <vector>

namespace drsplat {

// Runs work(0) ... work(threads - 1) at the same time; rethrows the first exception.
template <class Work>
void parallel(int threads, Work work) {
  std::vector<std::exception_ptr> errors(threads);
  const auto guarded = [&](int t) {
    try { work(t); } catch (...) { errors[t] = std::current_exception(); }
  };
  std::vector<std::thread> pool;
  for (int t = 1; t < threads; t++) pool.emplace_back(guarded, t);
  guarded(0);
  for (auto &thread : pool) thread.join();
  for (auto &error : errors)
    if (error) std::rethrow_exception(error);
}

// The t-th of `threads` equal parts of [0, n).
struct Part { uint32_t begin, end; };
inline Part part_of(uint32_t n, int threads, int t) {
  return {(uint32_t)((uint64_t)n * t / threads), (uint32_t)((uint64_t)n * (t + 1) / threads)};
}

}  // namespace drsplat
