// Helpers shared by the tests of articulations on devices.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "novaphy/core/sim/sim_state.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "support/cuda_device.h"
#include "support/device_bits.h"

namespace novaphy {

class ArticulationDevices : public testing::OnCuda {};

namespace testing {

// Returns `launches`, or a function that replays a capture of them.
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

inline nova::Tensor sum_of_squares(const std::vector<nova::Tensor>& tensors) {
  nova::Tensor sum;
  for (const nova::Tensor& x : tensors) {
    const nova::Tensor term = nova::sum(nova::mul(x, x));
    sum = sum.defined() ? nova::add(sum, term) : term;
  }
  return sum;
}

// Returns a direction for the values of a leaf: `first`, `first` + `step`, ..., seven values in
// turn.
inline nova::Tensor direction(const nova::Tensor& leaf, float step, float first) {
  std::vector<float> x(static_cast<size_t>(leaf.size()));
  for (size_t k = 0; k < x.size(); ++k) x[k] = step * static_cast<float>(k % 7) + first;
  nova::Tensor to(leaf.shape(), nova::DType::F32, leaf.device());
  to.copy_from_host(x.data(), x.size() * sizeof(float));
  return to;
}

}  // namespace testing
}  // namespace novaphy
