// Actuators, gravity compensation and a fluid on a CUDA device: states, gradients and tangents have the bits
// of the CPU, direct, replayed and from checkpoints. On a GPU, or on the fake driver
// (CMakeLists.txt).
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "articulation_devices.h"
#include "dynamics/all_joints_scene.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy {
namespace {

using testing::add;
using testing::bytes;
using testing::expect_same;
using testing::Result;

constexpr float kDt = 1.0f / 240.0f;

// Actuators of every kind of dynamics; three have ranges that cut.
ModelBuilder driven() {
  constexpr int32_t kKnee = 1, kSlide = 2, kHand = 4, kCart = 6, kWrist = 8, kTip = 9;
  ModelBuilder b = testing::AllJointsScene::make();
  for (int32_t& mode : b.joint_target_mode)
    mode = static_cast<int32_t>(JointTargetMode::POSITION_VELOCITY);
  b.add_actuator(kTip, {.gear = 1.5f, .ctrl_range = {-1.0f, 0.5f}, .ctrl = 0.8f});
  b.add_actuator(kKnee, {.gain = {20.0f, 1.0f, 0.5f},
                         .bias = {0.3f, -20.0f, -2.0f},
                         .ctrl_range = {-1.0f, 1.0f},
                         .ctrl = 0.2f});
  b.add_actuator(kSlide, {.gear = -2.0f,
                          .gain = {3.0f, 0.0f, 0.0f},
                          .dynamics = ActuatorDynamics::FILTER,
                          .time = 0.05f,
                          .ctrl = -0.7f,
                          .act = 0.1f});
  b.add_actuator(kHand, {.dynamics = ActuatorDynamics::INTEGRATOR,
                         .act_range = {-0.2f, 0.21f},
                         .ctrl = 3.0f,
                         .act = 0.2f});
  b.add_actuator(kCart, {.dynamics = ActuatorDynamics::FILTER_EXACT,
                         .time = 0.02f,
                         .force_range = {-1.0f, 0.3f},
                         .ctrl = 1.0f});
  b.add_actuator(kWrist, {.axis = 3, .gain = {5.0f, 0.0f, 0.0f}, .bias = {0.0f, -5.0f, 0.0f}});
  b.fluid = {.density = 40.0f, .viscosity = 0.3f, .wind = {1.0f, -0.5f, 0.2f}};
  // Actuators of bodies: a servo between two branches, and a force with a state.
  constexpr int32_t kSlideBody = 2, kHandBody = 4, kTipBody = 6;
  b.add_body_actuator(
      kHandBody, {.frame = {{0.1f, 0.0f, 0.2f}, {0.6f, 0.0f, 0.0f, 0.8f}},
                  .reference_body = kSlideBody,
                  .reference = {{0.0f, 0.3f, 0.0f}, {0.0f, 0.0f, 0.6f, 0.8f}},
                  .wrench = {{1.0f, 2.0f, -1.0f}, {0.3f, 0.1f, 0.2f}},
                  .axes = 7,
                  .law = {.gain = {4.0f, 0.3f, 0.0f}, .bias = {0.1f, -4.0f, -0.2f}, .ctrl = 0.5f}});
  b.add_body_actuator(
      kTipBody, {.wrench = {{0.0f, 0.5f, 1.0f}, {0.0f, 0.1f, 0.0f}},
                 .law = {.dynamics = ActuatorDynamics::INTEGRATOR, .ctrl = 0.3f, .act = 0.2f}});
  return b;
}

std::shared_ptr<Model> made(Device device, bool requires_grad) {
  const auto model = driven().finalize(device, {.requires_grad = requires_grad});
  std::vector<float> gravcomp(static_cast<size_t>(model->body_count()));
  for (size_t k = 0; k < gravcomp.size(); ++k) gravcomp[k] = 0.25f * static_cast<float>(k % 5);
  model->body_gravcomp.copy_from_host(std::span<const float>(gravcomp));
  return model;
}

void add_all(Result& result, const SimState& s, const std::string& when) {
  add(result, s, when);
  result.emplace_back(when + " act", bytes(s.act.to_host()));
}

TEST_F(ArticulationDevices, ActuatedStepsHaveTheBitsOfTheCpuDirectAndReplayed) {
  const auto run = [](Device device, bool captured) {
    const auto model = made(device, false);
    SolverFeatherstone solver(model);
    SimState a = model->state(), b = model->state();
    Control control = model->control();
    const auto pair = testing::replayed_if(captured, [&] {
      solver.step(a, b, &control, nullptr, kDt);
      solver.step(b, a, &control, nullptr, kDt);
    });
    Result result;
    for (int k = 0; k < 10; ++k) pair();
    add_all(result, a, "last");
    const std::vector<float> act = a.act.to_host();
    EXPECT_EQ(act[1], 0.21f);  // the integrator is at the bound of its range
    return result;
  };
  const Result expected = run(Device::cpu(), false);
  for (const bool captured : {false, true})
    expect_same(run(Device::cuda(), captured), expected, captured ? ", replayed" : ", direct");
}

// Returns the last state of a rollout, gradients of a loss over all states, and tangents along one
// direction.
Result trained(Device device, bool captured, int32_t checkpoint) {
  using namespace diff;
  const auto model = made(device, true);
  DiffFeatherstoneSolver solver(model, {}, false, DerivativeOf::Code);
  constexpr int32_t kSteps = 8;
  Trajectory trajectory(model, kSteps, true, checkpoint);
  Control control = model->control();
  const SimState &start = trajectory.state(0), &last = trajectory.any_state(kSteps);
  const std::vector<std::pair<const char*, nova::Tensor>> leaves = {
      {"joint_q", state_joint_q_tensor(start, true)},
      {"act", state_act_tensor(start, true)},
      {"ctrl", control_ctrl_tensor(control, true)},
      {"gear", model_actuator_gear_tensor(*model, true)},
      {"wrench", model_actuator_wrench_tensor(*model, true)},
      {"gain", model_actuator_gain_tensor(*model, true)},
      {"bias", model_actuator_bias_tensor(*model, true)},
      {"time", model_actuator_time_tensor(*model, true)},
      {"ctrl_range", model_actuator_ctrl_range_tensor(*model, true)},
      {"force_range", model_actuator_force_range_tensor(*model, true)},
      {"act_range", model_actuator_act_range_tensor(*model, true)},
      {"gravcomp", model_body_gravcomp_tensor(*model, true)},
      {"density", model_fluid_density_tensor(*model, true)},
      {"viscosity", model_fluid_viscosity_tensor(*model, true)},
      {"wind", model_fluid_wind_tensor(*model, true)},
      {"box", model_body_fluid_box_tensor(*model, true)}};
  std::vector<nova::Tensor> inputs, along, tangents;
  for (const auto& [name, leaf] : leaves) {
    inputs.push_back(leaf);
    along.push_back(testing::direction(leaf, 0.1f, -0.25f));
  }
  nova::Tensor loss;
  nova::ScopedCapture scope;
  if (!captured) scope.end();
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    solver.rollout(trajectory, &control, nullptr, kDt);
    const std::vector<nova::Tensor> outputs = {state_joint_q_tensor(last),
                                               state_joint_qd_tensor(last), state_act_tensor(last)};
    loss = testing::sum_of_squares(outputs);
    tangents = tape.jvp(outputs, inputs, along);
    tape.backward(loss);
  }
  scope.end();
  if (captured) scope.graph()->launch();
  Result result;
  add_all(result, last, "last");
  const auto add_values = [&](const std::string& name, const nova::Tensor& x) {
    const std::vector<float> values = x.to_host();
    EXPECT_TRUE(std::ranges::any_of(values, [](float v) { return v != 0.0f; })) << name;
    result.emplace_back(name, bytes(values));
  };
  for (const auto& [name, leaf] : leaves)
    add_values(std::string("gradient of ") + name, leaf.grad());
  for (const nova::Tensor& tangent : tangents) add_values("tangent", tangent);
  return result;
}

TEST_F(ArticulationDevices, GradientsOfActuatorsHaveTheBitsOfTheCpu) {
  const Result direct = trained(Device::cuda(), false, 1);
  const Result expected = trained(Device::cpu(), false, 1);
  expect_same(direct, expected, ", direct");
  // A replay adds to zeros, so zeros may have another sign.
  expect_same(trained(Device::cuda(), true, 1), trained(Device::cpu(), true, 1), ", replayed");
  expect_same(trained(Device::cuda(), false, 3), expected, ", from checkpoints");
}

}  // namespace
}  // namespace novaphy
