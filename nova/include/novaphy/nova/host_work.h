// Work of the host as a launch, which a capture records and replays: for what no kernel can do.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

struct HostWork {
  const char* name;                     // in errors
  std::vector<Tensor> reads, results;   // results: float32, which it writes
  std::vector<Tensor> writes = {};      // what it writes besides
  std::string* failure = nullptr;       // null, or lives as long as `run`; empty: none yet
  std::function<void()> run = nullptr;  // keeps what it uses alive
};

// In a capture: every replay calls `run`, behind what writes `reads` and before what reads
// `results` and `writes`. No replay passes on what it throws: `failure` says the first since it was
// empty, of which others may be consequences, and the results are NaN.
NOVAPHY_NOVA_API void capture_host_work(const HostWork& work);

}  // namespace nova
