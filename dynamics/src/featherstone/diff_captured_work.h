// Work of the host as a launch, which a capture records and replays.
#pragma once

#include <functional>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace novaphy {

// In a capture: every replay calls `run`, behind what writes `reads` and before what reads
// `writes`. It must not throw, and keeps what it uses alive.
void capture_articulation_work(const std::vector<nova::Tensor>& reads,
                               const std::vector<nova::Tensor>& writes, std::function<void()> run);

}  // namespace novaphy
