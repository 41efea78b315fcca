#include "novaphy/nova/host_work.h"

#include <algorithm>
#include <exception>
#include <limits>
#include <memory>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace nova {

using novaphy::LaunchArgument;

namespace {

constexpr uint32_t kWords = 64;
void run_work(const uint64_t* words, int64_t, int64_t, int64_t) {
  (*reinterpret_cast<const std::function<void()>*>(words[0]))();
}
constexpr novaphy_row_function kWork = {sizeof(novaphy_row_function), "host_work", kWords, 0,
                                        run_work};

void run_guarded(const HostWork& work) {
  try {
    work.run();
  } catch (const std::exception& error) {
    if (work.failure != nullptr && work.failure->empty()) *work.failure = error.what();
    for (const Tensor& result : work.results)
      std::fill_n(static_cast<float*>(result.range()->data()), result.size(),
                  std::numeric_limits<float>::quiet_NaN());
  }
}

}  // namespace

void capture_host_work(const HostWork& work) {
  // Never destroyed, because recordings refer to the kernel.
  static const auto& kernel = *new novaphy::DeviceKernel(kWork, nullptr);
  const NoGrad no_grad;
  const auto run = std::make_shared<const std::function<void()>>([work] { run_guarded(work); });
  std::vector<LaunchArgument> words = {
      novaphy::number(static_cast<int64_t>(reinterpret_cast<intptr_t>(run.get())))};
  const auto add = [&](const std::vector<Tensor>& tensors, bool write) {
    for (const Tensor& tensor : tensors) {
      if (!tensor.defined() || tensor.size() == 0) continue;
      LaunchArgument word;
      word.word = reinterpret_cast<uint64_t>(tensor.range()->data());
      word.name = work.name;
      word.range = tensor.range();
      word.read = true;
      word.write = write;
      words.push_back(std::move(word));
    }
  };
  add(work.reads, false);
  add(work.results, true);
  add(work.writes, true);
  novaphy::require(words.size() <= kWords, novaphy::ErrorKind::Runtime, work.name,
                   ": expected at most ", kWords, " arrays, got ", words.size());
  words.resize(kWords, novaphy::number(int64_t{0}));
  current_capture()->hold(run);
  kernel.launch(novaphy::Device::cpu(), 1, words);
}

}  // namespace nova
