#include "host/workspace.h"

#include <mutex>

namespace drsplat {
namespace {

struct Idle {
  std::mutex mutex;
  std::vector<std::unique_ptr<Workspace>> spaces;
};

Idle &idle() {
  static Idle idle;
  return idle;
}

}  // namespace

void release_idle() {
  std::vector<std::unique_ptr<Workspace>> spaces;
  const std::lock_guard<std::mutex> lock(idle().mutex);
  spaces.swap(idle().spaces);
}

Lease::Lease(int threads) {
  {
    const std::lock_guard<std::mutex> lock(idle().mutex);
    auto &spaces = idle().spaces;
    if (!spaces.empty()) space_ = std::move(spaces.back()), spaces.pop_back();
  }
  if (!space_) space_ = std::make_unique<Workspace>();
  while ((int)space_->workers.size() < threads) space_->workers.push_back(std::make_unique<Worker>());
}

Lease::~Lease() {
  const std::lock_guard<std::mutex> lock(idle().mutex);
  if (idle().spaces.size() < 2) idle().spaces.push_back(std::move(space_));
}

}  // namespace drsplat
