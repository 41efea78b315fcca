// What the tests of articulations on devices share.
#pragma once

#include <functional>
#include <string>

#include "novaphy/core/sim/sim_state.h"
#include "novaphy/nova/op_list.h"
#include "support/cuda_device.h"
#include "support/device_bits.h"

namespace novaphy {

class ArticulationDevices : public testing::OnCuda {};

namespace testing {

// `launches`, or what replays a capture of them.
inline std::function<void()> replayed_if(bool captured, const std::function<void()>& launches) {
  if (!captured) return launches;
  nova::ScopedCapture scope;
  launches();
  scope.end();
  return [graph = scope.graph()] { graph->launch(); };
}

inline void add(Result& result, const SimState& s, const std::string& when) {
  result.emplace_back(when + " joint_q", bytes(s.joint_q.to_host()));
  result.emplace_back(when + " joint_qd", bytes(s.joint_qd.to_host()));
  result.emplace_back(when + " body_q", bytes(s.body_q.to_host()));
  result.emplace_back(when + " body_qd", bytes(s.body_qd.to_host()));
}

}  // namespace testing
}  // namespace novaphy
