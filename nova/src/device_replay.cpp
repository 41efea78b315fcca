#include "device_replay.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <set>

#include "optional_entry.h"

namespace nova::detail {
namespace {

using std::chrono::seconds;

// The number of threads that compile. A list that is never destroyed may leave its thread running
// at the exit of the process. The exit destroys objects that the thread uses, so the exit waits
// until the number is 0.
std::atomic<int>& working() {
  static std::atomic<int> count{0};
  static const struct Exit {
    ~Exit() { wait_for_compilers(); }
  } exit;
  return count;
}
struct Work {
  Work() { ++working(); }
  ~Work() {
    --working();
    working().notify_all();
  }
  Work(const Work&) = delete;
  Work& operator=(const Work&) = delete;
};

// Returns whether the bits may depend on fusion, because a kernel allows contraction to fused
// multiply-adds. Such a list is not fused in the background, because the bits must not depend on
// the time at which the fused graph is ready.
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
  auto make = [=, &context, work = std::make_shared<Work>()]() mutable {
    // the future may live longer than the data of the work
    const std::shared_ptr<Work> until_done = std::move(work);
    return DeviceGraph::fused(context, ops, words, accesses);
  };
  fused_ = std::async(std::launch::async | std::launch::deferred, std::move(make));
  const bool no_thread_left = fused_.wait_for(seconds(0)) == std::future_status::deferred;
  if (no_thread_left || contracted(context, ops)) take();
}

void DeviceReplay::take() {
  if (!fused_.valid()) return;
  if (std::unique_ptr<DeviceGraph> fused = fused_.get()) graph_ = std::move(fused);
}

void DeviceReplay::have_graph() {
  if (!graph_) graph_ = DeviceGraph::plain(context_, ops_, words_);
}

void DeviceReplay::launch() {
  if (fused_.valid() && fused_.wait_for(seconds(0)) == std::future_status::ready) take();
  have_graph();
  graph_->launch();
}

void DeviceReplay::prepare() {
  take();
  have_graph();
}

}  // namespace nova::detail

namespace nova {

void wait_for_compilers() {
  std::atomic<int>& count = detail::working();
  for (int n = 0; (n = count) != 0;) count.wait(n);
}

}  // namespace nova
