// Work of the host as a launch, which a capture records and replays.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// In a capture: `run` is called by every replay, after what the reads need and before what needs
// the writes. It must not throw, and keeps what it uses alive.
void capture_host_work(const char* name, const std::vector<nova::Tensor>& reads,
                       const std::vector<nova::Tensor>& writes, std::function<void()> run);

}  // namespace novaphy::diff
