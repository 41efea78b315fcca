// Articulations on a CUDA device: steps and forward kinematics have the bits of the CPU. On a GPU,
// or on the fake driver (CMakeLists.txt).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "articulation_devices.h"
#include "dynamics/all_joints_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy {
namespace {

using testing::add;
using testing::AllJointsScene;
using testing::bytes;
using testing::expect_same;
using testing::expect_same_bits;
using testing::expect_thrown;
using testing::Result;

constexpr float kDt = 1.0f / 240.0f;

struct Steps {
  FeatherstoneOptions options = {};
  int pairs = 20;
  bool captured = false;
};
// States after pairs of steps, with wrenches on the bodies.
Result stepped(const Model& m, const Steps& how) {
  const auto model = m.shared_from_this();
  SolverFeatherstone solver(model, how.options);
  SimState a = model->state(), b = model->state();
  for (SimState* s : {&a, &b}) s->body_f.fill({{0.3f, -0.2f, 0.5f}, {0.1f, 0.2f, -0.1f}});
  Control control = model->control();
  const auto pair = [&] {
    solver.step(a, b, &control, nullptr, kDt);
    solver.step(b, a, &control, nullptr, kDt);
  };
  const std::function<void()> run = testing::replayed_if(how.captured, pair);
  Result result;
  for (int k = 0; k < how.pairs; ++k) {
    run();
    if (k % 5 == 4 || k + 1 == how.pairs) {
      add(result, a, "pair " + std::to_string(k));
      add(result, b, "pair " + std::to_string(k) + ", first");
    }
  }
  return result;
}

TEST_F(ArticulationDevices, StepsHaveTheBitsOfTheCpuDirectAndReplayed) {
  const ModelBuilder builder = AllJointsScene::make();
  const FeatherstoneOptions all[] = {
      {},
      {.implicit_drives = false},
      {.joint_limits = JointLimits::Row, .joint_limit_restitution = 0.6f}};
  for (const FeatherstoneOptions& options : all) {
    Steps how = {.options = options};
    const Result expected = stepped(*builder.finalize(Device::cpu()), how);
    const auto model = builder.finalize(Device::cuda());
    expect_same(stepped(*model, how), expected, ", direct");
    how.captured = true;
    expect_same(stepped(*model, how), expected, ", replayed");
  }
}

// Every array that a step reads, so that none is taken for another.
TEST_F(ArticulationDevices, EveryArrayActsAsOnTheCpu) {
  using Edit = std::function<void(Model&)>;
  const ModelBuilder builder = AllJointsScene::make();
  const auto run = [&](const Edit& edit) {
    Result results[2];
    for (const Device device : {Device::cpu(), Device::cuda()}) {
      const auto model = builder.finalize(device);
      edit(*model);
      results[device.is_cpu() ? 0 : 1] = stepped(*model, {.pairs = 2});
    }
    expect_same(results[1], results[0], "");
    return results[1];
  };
  const Result plain = run([](Model&) {});
  const auto scale = [](auto ModelFields::*array, float by) -> Edit {
    return [=](Model& m) {
      auto values = (m.*array).to_host();
      auto* const numbers = reinterpret_cast<float*>(values.data());
      for (size_t k = 0; k < sizeof(values[0]) / sizeof(float) * values.size(); ++k)
        if (std::abs(numbers[k]) < 1e5f) numbers[k] *= by;  // limits that are none stay
      (m.*array).copy_from_host(std::span(std::as_const(values)));
    };
  };
  const std::vector<std::pair<const char*, Edit>> edits = {
      {"joint_q", scale(&Model::joint_q, 1.1f)},
      {"joint_qd", scale(&Model::joint_qd, 1.1f)},
      {"joint_f", scale(&Model::joint_f, 1.1f)},
      {"joint_axis", scale(&Model::joint_axis, -1.0f)},
      {"joint_target_q", scale(&Model::joint_target_q, 1.1f)},
      {"joint_target_qd", scale(&Model::joint_target_qd, 1.1f)},
      {"joint_target_ke", scale(&Model::joint_target_ke, 1.1f)},
      {"joint_target_kd", scale(&Model::joint_target_kd, 1.1f)},
      {"joint_damping", scale(&Model::joint_damping, 1.1f)},
      {"joint_armature", scale(&Model::joint_armature, 1.1f)},
      {"joint_limit_lower", scale(&Model::joint_limit_lower, 1.1f)},
      {"joint_limit_upper", scale(&Model::joint_limit_upper, 0.9f)},
      {"joint_limit_ke", scale(&Model::joint_limit_ke, 1.1f)},
      {"joint_limit_kd", scale(&Model::joint_limit_kd, 1.1f)},
      {"joint_effort_limit", scale(&Model::joint_effort_limit, 0.5f)},
      {"joint_velocity_limit", scale(&Model::joint_velocity_limit, 0.5f)},
      {"body_mass", scale(&Model::body_mass, 1.1f)},
      {"body_com", scale(&Model::body_com, 1.1f)},
      {"body_inertia", scale(&Model::body_inertia, 1.1f)},
      {"gravity", scale(&Model::gravity, 1.1f)},
      {"joint_X_p", scale(&Model::joint_X_p, -1.0f)},
      {"joint_X_c", scale(&Model::joint_X_c, -1.0f)},
      {"joint_target_mode", [](Model& m) {
         std::vector<int32_t> modes = m.joint_target_mode.to_host();
         for (int32_t& mode : modes) mode = mode == 0 ? 3 : 0;
         m.joint_target_mode.copy_from_host(std::span<const int32_t>(modes));
       }}};
  for (const auto& [name, edit] : edits) {
    const Result other = run(edit);
    bool acts = false;
    for (size_t k = 0; k < other.size(); ++k) acts = acts || other[k].second != plain[k].second;
    EXPECT_TRUE(acts) << name;
  }
}

TEST_F(ArticulationDevices, AThousandWorldsHaveTheBitsOfTheCpu) {
  ModelBuilder all;
  all.replicate(AllJointsScene::make(), 1024, {2.0f, 0.0f, 0.0f});
  for (size_t k = 0; k < all.joint_qd.size(); ++k)
    all.joint_qd[k] *= 1.0f + 0.001f * static_cast<float>(k % 1013);
  expect_same_bits([&](Device device) { return stepped(*all.finalize(device), {.pairs = 2}); });
}

TEST_F(ArticulationDevices, ARolloutHasTheBitsOfTheCpu) {
  const ModelBuilder builder = AllJointsScene::make();
  expect_same_bits([&](Device device) {
    const auto model = builder.finalize(device);
    SolverFeatherstone solver(model);
    Trajectory trajectory(model, 12, false);
    solver.rollout(trajectory, nullptr, nullptr, kDt);
    Result result;
    for (const int32_t t : {1, 12}) add(result, trajectory.state(t), "state");
    return result;
  });
}

// States of a differentiable rollout, and gradients of a loss of all of the last one.
Result trained(Device device, bool captured, int32_t checkpoint) {
  using namespace diff;
  const auto model = AllJointsScene::make().finalize(device, {.requires_grad = true});
  DiffFeatherstoneSolver solver(model, {}, false, DerivativeOf::Code);
  constexpr int32_t kSteps = 12;
  Trajectory trajectory(model, kSteps, true, checkpoint);
  Control control = model->control();
  const SimState &start = trajectory.state(0), &last = trajectory.any_state(kSteps);
  const std::vector<std::pair<const char*, nova::Tensor>> leaves = {
      {"joint_q", state_joint_q_tensor(start, true)},
      {"joint_qd", state_joint_qd_tensor(start, true)},
      {"body_f", state_body_f_tensor(start, true)},
      {"joint_f", control_joint_f_tensor(control, true)},
      {"target_q", control_joint_target_q_tensor(control, true)},
      {"target_qd", control_joint_target_qd_tensor(control, true)},
      {"ke", model_joint_target_ke_tensor(*model, true)},
      {"kd", model_joint_target_kd_tensor(*model, true)},
      {"damping", model_joint_damping_tensor(*model, true)},
      {"mass", model_body_mass_tensor(*model, true)},
      {"com", model_body_com_tensor(*model, true)},
      {"inertia", model_body_inertia_tensor(*model, true)},
      {"gravity", model_gravity_tensor(*model, true)}};
  nova::Tensor loss;
  nova::ScopedCapture scope;
  if (!captured) scope.end();
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    solver.rollout(trajectory, &control, nullptr, kDt);
    loss = testing::sum_of_squares({state_joint_q_tensor(last), state_joint_qd_tensor(last),
                                    state_body_q_tensor(last), state_body_qd_tensor(last)});
    tape.backward(loss);
  }
  scope.end();
  if (captured) scope.graph()->launch();
  Result result;
  add(result, last, "last");
  result.emplace_back("loss", bytes(loss.to_host()));
  for (const auto& [name, leaf] : leaves) {
    const std::vector<float> values = leaf.grad().to_host();
    bool any = false;
    for (const float x : values) any = any || x != 0.0f;
    EXPECT_TRUE(any) << name;
    result.emplace_back(std::string("gradient of ") + name, bytes(values));
  }
  return result;
}

TEST_F(ArticulationDevices, RolloutsAndGradientsHaveTheBitsOfTheCpu) {
  const Result direct = trained(Device::cuda(), false, 1);  // first: nothing of the CPU is around
  const Result expected = trained(Device::cpu(), false, 1);
  expect_same(direct, expected, ", direct");
  // A replay adds to zeros, so zeros may have another sign.
  expect_same(trained(Device::cuda(), true, 1), trained(Device::cpu(), true, 1), ", replayed");
  expect_same(trained(Device::cuda(), false, 4), expected, ", from checkpoints");
}

// Tangents of the last state of a rollout, along one direction of all that has any.
Result tangents(Device device, bool captured, int32_t checkpoint) {
  using namespace diff;
  const auto model = AllJointsScene::make().finalize(device, {.requires_grad = true});
  DiffFeatherstoneSolver solver(model, {}, false, DerivativeOf::Code);
  constexpr int32_t kSteps = 6;
  Trajectory trajectory(model, kSteps, true, checkpoint);
  Control control = model->control();
  const SimState &start = trajectory.state(0), &last = trajectory.any_state(kSteps);
  const std::vector<nova::Tensor> leaves = {state_joint_q_tensor(start, true),
                                            state_joint_qd_tensor(start, true),
                                            state_body_f_tensor(start, true),
                                            control_joint_f_tensor(control, true),
                                            control_joint_target_q_tensor(control, true),
                                            control_joint_target_qd_tensor(control, true),
                                            model_joint_target_ke_tensor(*model, true),
                                            model_joint_target_kd_tensor(*model, true),
                                            model_joint_damping_tensor(*model, true),
                                            model_body_mass_tensor(*model, true),
                                            model_body_com_tensor(*model, true),
                                            model_body_inertia_tensor(*model, true),
                                            model_gravity_tensor(*model, true)};
  std::vector<nova::Tensor> along;
  for (const nova::Tensor& leaf : leaves) along.push_back(testing::direction(leaf, 0.1f, -0.25f));
  std::vector<nova::Tensor> found;
  nova::ScopedCapture scope;
  if (!captured) scope.end();
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    solver.rollout(trajectory, &control, nullptr, kDt);
    found = tape.jvp({state_joint_q_tensor(last), state_joint_qd_tensor(last),
                      state_body_q_tensor(last), state_body_qd_tensor(last)},
                     leaves, along);
  }
  scope.end();
  if (captured) scope.graph()->launch();
  Result result;
  add(result, last, "last");
  for (const nova::Tensor& tangent : found) {
    const std::vector<float> values = tangent.to_host();
    float most = 0.0f;
    for (const float x : values) most = std::max(most, std::abs(x));
    EXPECT_GT(most, 0.01f);
    result.emplace_back("tangent", bytes(values));
  }
  return result;
}

TEST_F(ArticulationDevices, TangentsHaveTheBitsOfTheCpu) {
  const Result direct = tangents(Device::cuda(), false, 1);
  const Result expected = tangents(Device::cpu(), false, 1);
  expect_same(direct, expected, ", direct");
  expect_same(tangents(Device::cuda(), true, 1), expected, ", replayed");
  expect_same(tangents(Device::cuda(), false, 3), expected, ", from checkpoints");
}

TEST_F(ArticulationDevices, AFailedStepOnATapeIsNamed) {
  const auto model = AllJointsScene::make().finalize(Device::cuda(), {.requires_grad = true});
  diff::DiffFeatherstoneSolver solver(model);
  SimState a = model->state(), b = model->state();
  std::vector<float> bad = model->joint_qd.to_host();
  bad[7] = std::numeric_limits<float>::infinity();
  a.joint_qd.copy_from_host(std::span<const float>(bad));
  expect_thrown(ErrorKind::Runtime, "DiffFeatherstoneSolver.step: dof ",
                [&] { solver.step(a, b, nullptr, nullptr, kDt); });
}

TEST_F(ArticulationDevices, ForwardKinematicsHasTheBitsOfTheCpuDirectAndReplayed) {
  ModelBuilder builder = AllJointsScene::make();
  const BodyArgs body = {.xform = {{1.0f, 2.0f, 3.0f}, Quatf::identity()},
                         .mass = 1.0f,
                         .inertia = Mat33f{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};
  const int32_t far = builder.add_link(body);
  builder.add_articulation(std::vector<int32_t>{builder.add_joint_distance(-1, far)});
  builder.add_joint_revolute(-1, builder.add_link(body));  // no articulation: it stays
  const auto run = [&](Device device, bool captured) {
    const auto model = builder.finalize(device);
    SimState state = model->state();
    std::vector<float> other = model->joint_q.to_host();  // quaternions of other lengths
    for (float& x : other) x += 0.3f;
    const auto q = DeviceArray<float>::from_host(other, device);
    nova::ScopedCapture scope;
    if (!captured) scope.end();
    eval_fk(*model, q, model->joint_qd, state);
    scope.end();
    if (captured) scope.graph()->launch();
    Result result;
    add(result, state, "state");
    return result;
  };
  const Result expected = run(Device::cpu(), false);
  for (const bool captured : {false, true})
    expect_same(run(Device::cuda(), captured), expected, captured ? ", replayed" : "");
}

TEST_F(ArticulationDevices, OneThatFailsIsNaNAndNamedAndTheOthersMove) {
  ModelBuilder all;
  all.replicate(AllJointsScene::make(), 3);
  const auto model = all.finalize(Device::cuda());
  const auto good = stepped(*all.finalize(Device::cpu()), {.pairs = 1});
  const size_t dofs = all.joint_qd.size() / 3, coords = all.joint_q.size() / 3,
               bodies = model->body_mass.rows() / 3;
  // The second articulation of the second world.
  const size_t bad_dof = 2 * dofs - 1, first_bad = 1 * dofs + 18;
  std::vector<float> qd = model->joint_qd.to_host();
  qd[bad_dof] = std::numeric_limits<float>::infinity();
  model->joint_qd.copy_from_host(std::span<const float>(qd));
  SolverFeatherstone solver(model);
  SimState a = model->state(), b = model->state();
  for (SimState* s : {&a, &b}) s->body_f.fill({{0.3f, -0.2f, 0.5f}, {0.1f, 0.2f, -0.1f}});
  solver.check_last_step();
  solver.step(a, b, nullptr, nullptr, kDt);
  expect_thrown(ErrorKind::Runtime, "SolverFeatherstone.step: dof ",
                [&] { solver.check_last_step(); });
  const std::vector<float> q = b.joint_q.to_host(), next = b.joint_qd.to_host();
  const std::vector<Transformf> poses = b.body_q.to_host();
  std::vector<float> expected(next.size());
  std::memcpy(expected.data(), good[5].second.data(), good[5].second.size());
  for (size_t k = 0; k < next.size(); ++k) {
    const bool failed = k >= first_bad && k < 2 * dofs;
    EXPECT_TRUE(failed ? std::isnan(next[k]) : next[k] == expected[k]) << k;
  }
  EXPECT_TRUE(std::isnan(q[2 * coords - 1]));
  EXPECT_FALSE(std::isnan(q[2 * coords]));
  EXPECT_TRUE(std::isnan(poses[2 * bodies - 1].p.x) && std::isnan(poses[2 * bodies - 1].q.w));
  EXPECT_FALSE(std::isnan(poses[2 * bodies].p.x));
}

TEST_F(ArticulationDevices, WhatIsNotThereIsRefusedByName) {
  constexpr auto kNot = ErrorKind::NotImplemented;
  ModelBuilder builder = AllJointsScene::make();
  builder.add_ground_plane();
  builder.add_shape_sphere(0, {.radius = 0.1f});
  const auto model = builder.finalize(Device::cuda());
  SimState a = model->state(), b = model->state();
  SolverFeatherstone solver(model), penalty(model, {.contact = ArticulationContact::Penalty});
  const Contacts contacts = CollisionPipeline(model).contacts();
  expect_thrown(kNot, "contacts: expected none of contact \"penalty\" on cuda:0",
                [&] { penalty.step(a, b, nullptr, &contacts, kDt); });
  Control control = model->control();
  control.joint_act.fill(0.5f);
  expect_thrown(kNot, "joint_act[0]", [&] { solver.step(a, b, &control, nullptr, kDt); });
  expect_thrown(kNot, "eval_ik: joint 8: expected perpendicular axes of a D6",
                [&] { eval_ik(*model, a, a.joint_q, a.joint_qd); });

  nova::ScopedCapture scope;
  solver.step(a, b, nullptr, nullptr, kDt);
  scope.end();
  scope.graph()->launch();
  model->joint_friction.fill(0.1f);
  EXPECT_THROW(scope.graph()->launch(), Error);
}

// A use of the step's results raises, as on the CPU, instead of losing the gradient silently.
TEST_F(ArticulationDevices, AStepOnATapeIsNotRecordedAndSaysSo) {
  const auto model = AllJointsScene::make().finalize(Device::cuda());
  SolverFeatherstone solver(model);
  SimState a = model->state(), b = model->state();
  const nova::Tensor qd = diff::state_joint_qd_tensor(a, true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  solver.step(a, b, nullptr, nullptr, kDt);
  expect_thrown(ErrorKind::Runtime, "SolverFeatherstone.step wrote it",
                [&] { tape.backward(nova::sum(diff::state_joint_qd_tensor(b))); });
}
TEST_F(ArticulationDevices, ForwardKinematicsOnATapeTakesNoGradients) {
  const auto model = AllJointsScene::make().finalize(Device::cuda());
  SimState a = model->state(), b = model->state();
  const nova::Tensor qd = diff::state_joint_qd_tensor(a, true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  expect_thrown(ErrorKind::Runtime, "joint_qd", [&] { eval_fk(*model, a.joint_q, a.joint_qd, b); });
}

}  // namespace
}  // namespace novaphy
