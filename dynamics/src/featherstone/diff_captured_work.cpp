#include "diff_captured_work.h"

#include <memory>
#include <utility>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy {
namespace {

constexpr const char* kName = "articulations_on_the_host";
constexpr uint32_t kWords = 64;
void run_work(const uint64_t* words, int64_t, int64_t, int64_t) {
  (*reinterpret_cast<const std::function<void()>*>(words[0]))();
}
constexpr novaphy_row_function kWork = {sizeof(novaphy_row_function), kName, kWords, 0, run_work};

}  // namespace

void capture_articulation_work(const std::vector<nova::Tensor>& reads,
                               const std::vector<nova::Tensor>& writes, std::function<void()> run) {
  static const auto& kernel = *new DeviceKernel(kWork, nullptr);  // recordings refer to it
  const nova::NoGrad no_grad;
  auto work = std::make_shared<const std::function<void()>>(std::move(run));
  std::vector<LaunchArgument> words = {
      number(static_cast<int64_t>(reinterpret_cast<intptr_t>(work.get())))};
  const auto add = [&](const std::vector<nova::Tensor>& tensors, bool write) {
    for (const nova::Tensor& tensor : tensors) {
      if (!tensor.defined() || tensor.size() == 0) continue;
      LaunchArgument word;
      word.word = reinterpret_cast<uint64_t>(tensor.range()->data());
      word.name = kName;
      word.range = tensor.range();
      word.read = true;
      word.write = write;
      words.push_back(std::move(word));
    }
  };
  add(reads, false);
  add(writes, true);
  require(words.size() <= kWords, ErrorKind::Runtime, kName, ": expected at most ", kWords,
          " arrays, got ", words.size());
  words.resize(kWords, number(int64_t{0}));
  nova::current_capture()->hold(work);
  kernel.launch(Device::cpu(), 1, words);
}

}  // namespace novaphy
