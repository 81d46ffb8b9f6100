// Threads for one call: started and joined inside it, so forking and calling from many threads are safe.
#pragma once
#include <cstdint>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace drsplat {

// Runs work(0) ... work(threads - 1) at the same time, as far as the system gives threads: the rest runs here. No
// work waits for another's. Rethrows the first exception.
template <class Work>
void parallel(int threads, Work work) {
  std::vector<std::exception_ptr> errors(threads);
  const auto guarded = [&](int t) {
    try { work(t); } catch (...) { errors[t] = std::current_exception(); }
  };
  std::vector<std::thread> pool;
  pool.reserve((size_t)threads);
  try {
    while ((int)pool.size() + 1 < threads) pool.emplace_back(guarded, (int)pool.size() + 1);
  } catch (const std::system_error &) {
  } catch (const std::bad_alloc &) {
  }
  guarded(0);
  for (int t = (int)pool.size() + 1; t < threads; t++) guarded(t);
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
