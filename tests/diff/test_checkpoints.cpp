// A trajectory that keeps only some of its states: the results have the same bits, and a read of a
// missing state is an error.
#include <gtest/gtest.h>

#include "diff/ball_scene.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/soft_body_scene.h"

namespace novaphy::testing {
namespace {

using diff::Trajectory;
using nova::KeepGradients;
using nova::Tensor;

constexpr int kSteps = 60;

struct Result {
  std::vector<Vec3f> q;  // the positions of some states
  std::vector<float> grad_q, grad_qd, grad_material;
  float loss = 0.0f;
  bool operator==(const Result&) const = default;
};

struct Way {
  int32_t interval = 1;
  bool captured = false;
  KeepGradients keep = KeepGradients::All;
  int backwards = 1;
};

// A rollout with a loss on the last state and on one in the middle, which every interval keeps.
Result run(const std::shared_ptr<Model>& model, diff::DiffSemiImplicitSolver& solver,
           const Contacts* contacts, const Tensor& material, const Way& way) {
  Trajectory trajectory(model, kSteps, true, way.interval);
  const Tensor q0 = diff::state_particle_q_tensor(trajectory.state(0), true),
               qd0 = diff::state_particle_qd_tensor(trajectory.state(0), true);
  material.zero_grad();
  Tensor loss;
  const auto iteration = [&] {
    nova::Tape tape(way.keep);
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, contacts, 4.0f * kBallDt);
    const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
    const Tensor first = diff::state_particle_q_tensor(trajectory.state(0));
    loss = nova::add(nova::dot(last, last), nova::dot(first, last));
    for (int k = 0; k < way.backwards; ++k) tape.backward(loss);
  };
  if (way.captured) {
    nova::ScopedCapture capture;
    iteration();
    capture.end();
    capture.graph()->prepare();
    capture.graph()->launch();
  } else {
    iteration();
  }
  Result result;
  for (const int t : {0, 1, 6, 7, 13, 31, kSteps - 1, kSteps})
    for (const Vec3f& x : trajectory.recompute(t).particle_q.to_host()) result.q.push_back(x);
  result.grad_q = q0.grad().to_host();
  result.grad_qd = qd0.grad().to_host();
  result.grad_material = material.grad().to_host();
  result.loss = loss.item();
  return result;
}

void expect_same(const Result& got, const Result& expected) {
  EXPECT_EQ(got.loss, expected.loss);
  EXPECT_TRUE(same_bits<Vec3f>(got.q, expected.q));
  EXPECT_TRUE(same_bits<float>(got.grad_q, expected.grad_q));
  EXPECT_TRUE(same_bits<float>(got.grad_qd, expected.grad_qd));
  EXPECT_TRUE(same_bits<float>(got.grad_material, expected.grad_material));
}

constexpr int32_t kIntervals[] = {2, 7, kSteps, 1000};

class CheckpointedBalls : public ::testing::TestWithParam<int> {};

TEST_P(CheckpointedBalls, GiveTheBitsOfKeepingEverything) {
  const auto model = make_ball_model(GetParam());
  // Captures have the derivative of the code.
  diff::DiffSemiImplicitSolver solver(model, {.contact_gradient = diff::DerivativeOf::Code});
  const Contacts contacts = make_ball_contacts(model, model->state());
  const Tensor ke = diff::model_shape_material_ke_tensor(*model, true);
  const Result all = run(model, solver, &contacts, ke, {});
  EXPECT_NE(all.grad_material, std::vector<float>(all.grad_material.size(), 0.0f));
  for (const int32_t interval : kIntervals)
    for (const bool captured : {false, true})
      for (const KeepGradients keep : {KeepGradients::All, KeepGradients::Leaves}) {
        SCOPED_TRACE(interval);
        expect_same(run(model, solver, &contacts, ke, {interval, captured, keep}), all);
      }
}
INSTANTIATE_TEST_SUITE_P(Sizes, CheckpointedBalls, ::testing::Values(1, 40, 5001));

TEST(Checkpoints, GiveTheBitsOfKeepingEverythingWhereElementsAct) {
  const auto model = make_soft_body_model();
  diff::DiffSemiImplicitSolver solver(
      model, {.enable_tetrahedra = true, .enable_triangles = true, .enable_static_contacts = true});
  const Tensor materials = diff::model_tet_material_tensor(*model, true);
  const Result all = run(model, solver, nullptr, materials, {});
  EXPECT_NE(all.grad_material, std::vector<float>(all.grad_material.size(), 0.0f));
  for (const int32_t interval : kIntervals) {
    SCOPED_TRACE(interval);
    expect_same(run(model, solver, nullptr, materials, {interval}), all);
  }
}

TEST(Checkpoints, ABackwardThatIsCalledTwiceGivesTwice) {
  const auto model = make_ball_model(3);
  diff::DiffSemiImplicitSolver solver(model);
  const Contacts contacts = make_ball_contacts(model, model->state());
  const Tensor ke = diff::model_shape_material_ke_tensor(*model, true);
  expect_same(run(model, solver, &contacts, ke, {.interval = 7, .backwards = 2}),
              run(model, solver, &contacts, ke, {.backwards = 2}));
}

// Runs f, and returns the message of its exception.
template <class F>
std::string message_of(F&& f) {
  try {
    f();
  } catch (const std::exception& e) {
    return e.what();
  }
  return {};
}

TEST(Checkpoints, AStateThatIsNotKeptIsRefusedByName) {
  const auto model = make_ball_model();
  Trajectory trajectory(model, 20, true, 8);
  EXPECT_EQ(trajectory.stored_count(), 4);  // 0, 8, 16, 20
  EXPECT_EQ(trajectory.particle_q().size(), 4u);
  EXPECT_NO_THROW(trajectory.state(16));
  EXPECT_NO_THROW(trajectory.state(20));
  const std::string message = message_of([&] { trajectory.state(9); });
  EXPECT_NE(message.find("state 9 is not kept, but those of t = 0, 8, 16, ... and 20 are"),
            std::string::npos)
      << message;
  Trajectory shorter(model, 20, true, 13);
  EXPECT_NE(message_of([&] { shorter.state(9); }).find("those of t = 0, 13 and 20 are"),
            std::string::npos);
  EXPECT_NE(message_of([&] { trajectory.recompute(9); }).find("no rollout yet"), std::string::npos);
  EXPECT_NE(message_of([&] { Trajectory(model, 20, true, 0); }).find("interval >= 1, got 0"),
            std::string::npos);
}

TEST(Checkpoints, WhatChangedSinceTheRolloutIsNoticed) {
  const auto model = make_ball_model();
  diff::DiffSemiImplicitSolver solver(model);
  const Contacts contacts = make_ball_contacts(model, model->state());
  Trajectory trajectory(model, kSteps, true, 8);
  const Tensor qd0 = diff::state_particle_qd_tensor(trajectory.state(0), true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  solver.rollout(trajectory, nullptr, &contacts, kBallDt);
  const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
  const Tensor loss = nova::dot(last, last);
  const Vec3f elsewhere{0.0f, 0.0f, 3.0f};
  trajectory.state(16).particle_q.copy_from_host(&elsewhere, sizeof(elsewhere));
  EXPECT_NE(message_of([&] { tape.backward(loss); }).find("was modified after recording"),
            std::string::npos);
  const std::string message = message_of([&] { trajectory.recompute(17); });
  EXPECT_NE(message.find("does not lead to the kept state 24"), std::string::npos) << message;
}

TEST(Checkpoints, TheIntervalFollowsFromTheMemory) {
  const auto model = make_ball_model(100);  // 2400 bytes a state
  EXPECT_EQ(diff::checkpoint_interval_for(*model, 100, 101 * 2400), 1);
  EXPECT_EQ(diff::checkpoint_interval_for(*model, 100, 101 * 2400 - 1), 2);  // 51 + 1 states
  EXPECT_EQ(diff::checkpoint_interval_for(*model, 100, 20 * 2400), 10);      // 11 + 9
  EXPECT_THROW(diff::checkpoint_interval_for(*model, 100, 19 * 2400), Error);
}

}  // namespace
}  // namespace novaphy::testing
