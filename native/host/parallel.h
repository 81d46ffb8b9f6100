// Threads for one call: started and joined inside it, so forking and calling from many threads are safe.
#pragma once
#include <algorithm>
#include <atomic>
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
    try {
      work(t);
    } catch (...) { errors[t] = std::current_exception(); }
  };
  std::vector<std::thread> pool;
  pool.reserve((size_t)threads);
  try {
    while ((int)pool.size() + 1 < threads) pool.emplace_back(guarded, (int)pool.size() + 1);
  } catch (const std::system_error &) {
  } catch (const std::bad_alloc &) {}
  guarded(0);
  for (int t = (int)pool.size() + 1; t < threads; t++) guarded(t);
  for (auto &thread : pool) thread.join();
  for (auto &error : errors)
    if (error) std::rethrow_exception(error);
}

// Where the t-th of `threads` equal parts of [0, n) begins.
template <class Count>
Count part_start(Count n, int threads, int t) {
  return (Count)((uint64_t)n * (uint64_t)t / (uint64_t)threads);
}

// work(t, begin, end) for each of `threads` equal parts of [0, n).
template <class Count, class Work>
void over_parts(Count n, int threads, Work work) {
  parallel(threads, [&](int t) { work(t, part_start(n, threads, t), part_start(n, threads, t + 1)); });
}

// work(t, begin, end) for blocks of [0, rows), handed out as threads become free; t is the number of the thread.
template <class Work>
void over_rows(uint64_t rows, uint64_t block, int threads, Work work) {
  std::atomic<uint64_t> next{0};
  const uint64_t blocks = (rows + block - 1) / block;
  parallel((int)std::max<uint64_t>(1, std::min<uint64_t>(threads, blocks)), [&](int t) {
    for (uint64_t i; (i = next.fetch_add(1)) < blocks;) work(t, i * block, std::min(rows, (i + 1) * block));
  });
}

}  // namespace drsplat
