// Host code as a launch that a capture records and replays, for work that no kernel can do.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

struct HostWork {
  const char* name;                     // for error messages
  std::vector<Tensor> reads, results;   // results: float32 tensors that `run` writes
  std::vector<Tensor> writes = {};      // other tensors that `run` writes
  std::string* failure = nullptr;       // error text, empty without an error; null, or lives as
                                        // long as `run`
  std::function<void()> run = nullptr;  // keeps the objects that it uses alive
};

// Records host work into the active capture. Every replay calls `run`, after the writers of `reads`
// and before the readers of `results` and `writes`. If `run` throws, the replay continues with NaN
// results, and `failure` gets the message if it is empty. Later failures may be consequences of the
// first.
NOVAPHY_NOVA_API void capture_host_work(const HostWork& work);

}  // namespace nova
