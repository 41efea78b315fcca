#include "device_replay.h"

#include <algorithm>
#include <chrono>
#include <mutex>
#include <set>
#include <shared_mutex>

#include "optional_entry.h"

namespace nova::detail {
namespace {

using std::chrono::seconds;

// A list that is never destroyed leaves its thread running when the process exits. The exit waits
// for those that hold this, because they use what it destroys.
std::shared_mutex& before_exit() {
  static auto& mutex = *new std::shared_mutex;
  static const struct Exit {
    ~Exit() { mutex.lock(); }
  } exit;
  return mutex;
}

// Whether the bits may depend on what is fused. They must not depend on when it is there.
bool contracted(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops) {
  const novaphy_backend_api& api = *context.api;
  if (!has_entry(api, &novaphy_backend_api::kernel_info)) return false;
  std::set<novaphy_kernel*> kernels;
  for (const OpList::Op& op : ops)
    if (op.kernel != nullptr) kernels.insert(op.kernel);
  return std::any_of(kernels.begin(), kernels.end(), [&](novaphy_kernel* kernel) {
    novaphy_kernel_info info{};
    info.struct_size = sizeof(info);
    novaphy_error error = novaphy::make_error();
    novaphy::check(api.kernel_info(kernel, &info, &error), error, "graph");
    return info.native == 2;
  });
}

}  // namespace

DeviceReplay::DeviceReplay(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
                           std::span<const uint64_t> words, std::span<const MemoryAccess> accesses)
    : context_(context), ops_(ops), words_(words) {
  const auto make = [=, &context, &mutex = before_exit()]() -> std::unique_ptr<DeviceGraph> {
    const std::shared_lock lock(mutex, std::try_to_lock);
    return lock ? DeviceGraph::fused(context, ops, words, accesses) : nullptr;
  };
  fused_ = std::async(std::launch::async | std::launch::deferred, make);
  const bool no_thread_left = fused_.wait_for(seconds(0)) == std::future_status::deferred;
  if (no_thread_left || contracted(context, ops)) finish();
}

void DeviceReplay::launch() {
  if (fused_.valid() && fused_.wait_for(seconds(0)) == std::future_status::ready) finish();
  if (!graph_) graph_ = DeviceGraph::plain(context_, ops_, words_);
  graph_->launch();
}

void DeviceReplay::finish() {
  if (!fused_.valid()) return;
  if (std::unique_ptr<DeviceGraph> fused = fused_.get()) graph_ = std::move(fused);
}

}  // namespace nova::detail
