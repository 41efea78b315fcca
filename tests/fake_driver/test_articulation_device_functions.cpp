// The functions of the dynamics of articulations, and inverse kinematics, on a CUDA device: the
// bits of the CPU. On a GPU, or on the fake driver (CMakeLists.txt).
#include <gtest/gtest.h>

#include <span>
#include <string>
#include <utility>
#include <vector>

#include "articulation_contact_scenes.h"
#include "articulation_devices.h"
#include "dynamics/all_joints_scene.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/featherstone/articulation_functions.h"
#include "novaphy/dynamics/featherstone/control_sensitivity.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/nova/op_list.h"

namespace novaphy {
namespace {

using testing::AllJointsScene;
using testing::bytes;
using testing::expect_same;
using testing::expect_same_bits;
using testing::expect_thrown;
using testing::Result;

// Trees of several sizes. One has many hinges in a row, and one has a mimic joint.
ModelBuilder trees() {
  ModelBuilder all;
  all.replicate(AllJointsScene::make(), 5, {2.0f, 0.0f, 0.0f});
  testing::contact_scenes::add_snake(all, 0.0f, 0.0f);
  const BodyArgs body = {.com = {0.1f, 0.0f, 0.2f},
                         .mass = 1.0f,
                         .inertia = Mat33f{{{1, 0, 0}, {0, 1, 0}, {0, 0, 2}}}};
  const int32_t upper = all.add_link(body), lower = all.add_link(body);
  const int32_t one = all.add_joint_revolute(-1, upper),
                two = all.add_joint_prismatic(upper, lower);
  all.add_articulation(std::vector<int32_t>{one, two});
  all.add_constraint_mimic(two, one, 0.0f, 0.7f);
  return all;
}

Result evaluated(const Model& m, const SimState& s) {
  std::vector<float> given(static_cast<size_t>(m.joint_dof_count()));
  for (size_t k = 0; k < given.size(); ++k) given[k] = 0.3f * static_cast<float>(k % 7) - 0.8f;
  Result result;
  const auto add = [&](const char* name, const auto& values) {
    bool any = false;
    for (const auto& x : bytes(values)) any = any || x != decltype(x){};
    EXPECT_TRUE(any) << name;
    result.emplace_back(name, bytes(values));
  };
  add("inverse dynamics", eval_inverse_dynamics(m, s, given));
  add("bias", eval_bias(m, s));
  add("forward dynamics", eval_forward_dynamics(m, s, given));
  add("mass matrix", eval_mass_matrix(m, s).values);
  add("mass matrix without armature", eval_mass_matrix(m, s, false).values);
  add("jacobian", eval_jacobian(m, s).values);
  const InverseDynamicsDerivatives inverse = eval_inverse_dynamics_derivatives(m, s, given);
  add("dtau_dq", inverse.dtau_dq.values);
  add("dtau_dqd", inverse.dtau_dqd.values);
  add("mass matrix of derivatives", inverse.mass_matrix.values);
  const ForwardDynamicsDerivatives forward = eval_forward_dynamics_derivatives(m, s, given);
  add("dqdd_dq", forward.dqdd_dq.values);
  add("dqdd_dqd", forward.dqdd_dqd.values);
  add("inverse mass matrix", forward.inverse_mass_matrix.values);
  add("center of mass", eval_center_of_mass(m, s));
  add("energy", eval_energy(m, s));
  return result;
}

TEST_F(ArticulationDevices, FunctionsHaveTheBitsOfTheCpu) {
  const ModelBuilder builder = trees();
  expect_same_bits([&](Device device) {
    const auto model = builder.finalize(device);
    return evaluated(*model, model->state());
  });
}

// The functions read the present values. Neither a tape nor earlier reads matter.
TEST_F(ArticulationDevices, FunctionsReadWhatWasWritten) {
  const ModelBuilder builder = trees();
  const auto run = [&](Device device, bool edited) {
    const auto model = builder.finalize(device);
    SimState state = model->state();
    if (edited) {
      evaluated(*model, state);
      model->gravity.fill({1.0f, -2.0f, 3.0f});
      model->joint_armature.fill(0.5f);
      state.joint_qd.fill(0.25f);
    }
    return evaluated(*model, state);
  };
  const Result expected = run(Device::cpu(), true), plain = run(Device::cpu(), false);
  expect_same(run(Device::cuda(), true), expected, ", edited");
  EXPECT_NE(expected[0].second, plain[0].second);
}

TEST_F(ArticulationDevices, ASingularMassMatrixIsNamed) {
  ModelBuilder builder = trees();
  const int32_t massless = builder.add_link();
  builder.add_articulation(std::vector<int32_t>{builder.add_joint_revolute(-1, massless)});
  const auto model = builder.finalize(Device::cuda());
  const SimState state = model->state();
  const std::vector<float> tau(static_cast<size_t>(model->joint_dof_count()), 1.0f);
  const std::string name =
      "eval_forward_dynamics: dof " + std::to_string(model->joint_dof_count() - 1) + " (joint '";
  expect_thrown(ErrorKind::Runtime, name.c_str(),
                [&] { eval_forward_dynamics(*model, state, tau); });
  eval_inverse_dynamics(*model, state, tau);
}

TEST_F(ArticulationDevices, WhatFunctionsCannotDoThereIsRefusedByName) {
  const auto model = trees().finalize(Device::cuda());
  SimState state = model->state();
  {
    const nova::ScopedCapture scope;
    expect_thrown(ErrorKind::Runtime, "eval_bias", [&] { eval_bias(*model, state); });
  }
  const auto on_cpu = trees().finalize(Device::cpu());
  expect_thrown(ErrorKind::Value, "eval_bias, state: expected one of the model",
                [&] { eval_bias(*model, on_cpu->state()); });
  ModelBuilder rail;
  const int32_t link =
      rail.add_link({.mass = 1.0f, .inertia = Mat33f{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}});
  rail.add_articulation(std::vector<int32_t>{rail.add_joint_prismatic(-1, link)});
  const auto one = rail.finalize(Device::cuda());
  expect_thrown(ErrorKind::NotImplemented,
                "FeatherstoneAnalyticControlSensitivity: model: step a copy",
                [&] { FeatherstoneAnalyticControlSensitivity(one, {}); });
}

TEST_F(ArticulationDevices, MimicJointsAreWrittenWithTheBitsOfTheCpu) {
  const ModelBuilder builder = trees();
  const auto run = [&](Device device, bool captured) {
    const auto model = builder.finalize(device);
    SimState state = model->state();
    std::vector<float> q = state.joint_q.to_host();
    const float before = q.back();
    for (float& x : q) x += 0.3f;
    state.joint_q.copy_from_host(std::span<const float>(q));
    testing::replayed_if(captured, [&] { eval_mimic(*model, state.joint_q, state.joint_qd); })();
    const std::vector<float> got = state.joint_q.to_host();
    EXPECT_NEAR(got.back(), 0.7f * (q[q.size() - 2]), 1e-6f);
    EXPECT_NE(got.back(), before);
    return Result{{"joint_q", bytes(got)}, {"joint_qd", bytes(state.joint_qd.to_host())}};
  };
  const Result expected = run(Device::cpu(), false);
  for (const bool captured : {false, true})
    expect_same(run(Device::cuda(), captured), expected, captured ? ", replayed" : "");
}

TEST_F(ArticulationDevices, InverseKinematicsHasTheBitsOfTheCpuDirectAndReplayed) {
  ModelBuilder builder;
  const BodyArgs body = {.com = {0.1f, -0.05f, 0.2f},
                         .mass = 1.0f,
                         .inertia = Mat33f{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};
  const AxisJointArgs off = {.parent_xform = {{0.1f, 0.2f, 0.3f}, {0.48f, 0.6f, 0.0f, 0.64f}},
                             .child_xform = {{-0.2f, 0.1f, 0.0f}, {0.0f, 0.6f, 0.0f, 0.8f}}};
  std::vector<int32_t> links, joints;
  for (int k = 0; k < 6; ++k) links.push_back(builder.add_link(body));
  joints.push_back(builder.add_joint_free(links[0]));
  joints.push_back(builder.add_joint_revolute(links[0], links[1], off));
  joints.push_back(builder.add_joint_prismatic(links[1], links[2], off));
  joints.push_back(builder.add_joint_ball(links[2], links[3]));
  joints.push_back(builder.add_joint_fixed(links[3], links[4]));
  JointArgs six;
  for (const Vec3f axis : {Vec3f{1, 0, 0}, Vec3f{0, 0, 1}}) {
    JointDofConfig dof;
    dof.axis = axis;
    six.linear_axes.push_back(dof);
    six.angular_axes.push_back(dof);
  }
  joints.push_back(builder.add_joint_d6(links[4], links[5], six));
  builder.add_articulation(joints);
  for (size_t k = 0; k < builder.joint_qd.size(); ++k)
    builder.joint_qd[k] = 0.2f * static_cast<float>(k % 5) - 0.3f;
  for (size_t k = 7; k < 9; ++k) builder.joint_q[k] = 0.4f;
  const auto run = [&](Device device, bool captured) {
    const auto model = builder.finalize(device);
    SimState from = model->state(), to = model->state();
    eval_fk(*model, from.joint_q, from.joint_qd, from);
    to.joint_q.fill(0.0f);
    to.joint_qd.fill(0.0f);
    testing::replayed_if(captured, [&] { eval_ik(*model, from, to.joint_q, to.joint_qd); })();
    const std::vector<float> q = to.joint_q.to_host(), qd = to.joint_qd.to_host();
    for (size_t k = 0; k < qd.size(); ++k) EXPECT_NEAR(qd[k], builder.joint_qd[k], 1e-5f) << k;
    return Result{{"joint_q", bytes(q)}, {"joint_qd", bytes(qd)}};
  };
  const Result expected = run(Device::cpu(), false);
  for (const bool captured : {false, true})
    expect_same(run(Device::cuda(), captured), expected, captured ? ", replayed" : "");
}

}  // namespace
}  // namespace novaphy
