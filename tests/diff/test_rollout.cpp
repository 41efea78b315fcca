// Inputs of a rollout: forces and controls that change over time, parts of a trajectory, and
// solvers that implement only a single step.
#include <gtest/gtest.h>

#include <set>

#include "diff/ball_scene.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/soft_body_scene.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using diff::DiffSemiImplicitSolver;
using diff::Trajectory;
using nova::Tensor;

constexpr int32_t kSteps = 24;
constexpr float kDt = 2.0e-3f;
const diff::DiffSolverConfig kSoft = {
    .enable_tetrahedra = true, .enable_triangles = true, .enable_static_contacts = true};

DeviceArray<Vec3f> forces_over(size_t rows, float scale) {
  std::vector<Vec3f> f(rows);
  for (size_t k = 0; k < rows; ++k)
    f[k] = {scale * static_cast<float>(k % 7), -scale * static_cast<float>(k % 3),
            scale * static_cast<float>(k % 5)};
  return DeviceArray<Vec3f>::from_host(f);
}
Tensor tensor_of(const DeviceArray<Vec3f>& array) { return Tensor::view(array, true); }

// States of a loop of step in which the forces are set before every step.
std::vector<Vec3f> states_step_by_step(SolverBase& solver, const DeviceArray<Vec3f>& constant,
                                       const DeviceArray<Vec3f>& forces) {
  const Model& model = *solver.model();
  const auto n = static_cast<size_t>(model.particle_count());
  SimState now = model.state(), next = model.state();
  const std::vector<Vec3f> base = constant.to_host(), all = forces.to_host();
  std::vector<Vec3f> states = now.particle_q.to_host();
  for (size_t t = 0; t < kSteps; ++t) {
    std::vector<Vec3f> f(n);
    for (size_t p = 0; p < n; ++p) f[p] = base[p] + all[t * n + p];
    now.particle_f.copy_from_host(f);
    solver.step(now, next, nullptr, nullptr, kDt);
    std::swap(now, next);
    for (const Vec3f& x : now.particle_q.to_host()) states.push_back(x);
  }
  return states;
}

TEST(Rollout, ForcesOverTimeAddToThoseOfTheTrajectoryOnEveryPath) {
  const auto model = make_soft_body_model();
  const auto n = static_cast<size_t>(model->particle_count());
  const DeviceArray<Vec3f> constant = forces_over(n, 1e-3f),
                           forces = forces_over(kSteps * n, 2e-3f);
  DiffSemiImplicitSolver recorded(
      model,
      {.enable_particle_contacts = false, .enable_tetrahedra = true, .enable_triangles = true});
  SolverSemiImplicit forward(model);
  for (SolverBase* solver :
       {static_cast<SolverBase*>(&recorded), static_cast<SolverBase*>(&forward)}) {
    const std::vector<Vec3f> expected = states_step_by_step(*solver, constant, forces);
    Trajectory trajectory(model, kSteps);
    trajectory.state(0).particle_f.assign(constant);
    solver->rollout(trajectory, nullptr, nullptr, kDt, {.forces = &forces});
    EXPECT_TRUE(same_bits<Vec3f>(trajectory.particle_q().to_host(), expected));
    EXPECT_TRUE(same_bits<Vec3f>(trajectory.particle_f().to_host(), constant.to_host()));
    Trajectory some(model, kSteps, true, 5);
    some.state(0).particle_f.assign(constant);
    solver->rollout(some, nullptr, nullptr, kDt, {.forces = &forces});
    const std::vector<Vec3f> middle = some.recompute(13).particle_q.to_host();
    EXPECT_TRUE(same_bits<Vec3f>(middle, std::span(expected).subspan(13 * n, n)));
  }
}

struct Gradients {
  std::vector<float> q, forces, constant;
  bool operator==(const Gradients&) const = default;
};

Gradients gradients(const std::shared_ptr<Model>& model, const diff::DiffSolverConfig& config,
                    const DeviceArray<Vec3f>& forces, int32_t interval, bool captured,
                    nova::KeepGradients keep, float* loss_value = nullptr) {
  DiffSemiImplicitSolver solver(model, config);
  Trajectory trajectory(model, kSteps, true, interval);
  const Tensor q = diff::state_particle_q_tensor(trajectory.state(0), true),
               f = diff::state_particle_f_tensor(trajectory.state(0), true), u = tensor_of(forces);
  u.zero_grad();
  Tensor loss;
  const auto iteration = [&] {
    nova::Tape tape(keep);
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, nullptr, kDt, {.forces = &forces});
    const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
    loss = nova::dot(last, last);
    tape.backward(loss);
  };
  if (captured) {
    nova::ScopedCapture capture;
    iteration();
    capture.end();
    capture.graph()->launch();
  } else {
    iteration();
  }
  if (loss_value != nullptr) *loss_value = loss.item();
  return {q.grad().to_host(), u.grad().to_host(), f.grad().to_host()};
}

TEST(Rollout, TheGradientOfForcesIsTheSameCheckpointedCapturedAndOnAnyThreads) {
  for (const bool soft : {true, false})
    for (const bool change : {true, false}) {
      const auto model = soft ? make_soft_body_model(3) : make_ball_model(3000);
      const diff::DiffSolverConfig config =
          soft ? kSoft : diff::DiffSolverConfig{.enable_static_contacts = true};
      const auto n = static_cast<size_t>(model->particle_count());
      const DeviceArray<Vec3f> forces = forces_over(change ? kSteps * n : n, 1e-3f);
      const Gradients all = gradients(model, config, forces, 1, false, nova::KeepGradients::All);
      EXPECT_NE(all.forces, std::vector<float>(all.forces.size(), 0.0f));
      for (const int threads : {1, 2, 7})
        for (const int32_t interval : {1, 5, kSteps})
          for (const bool captured : {false, true}) {
            const Threads set(threads);
            const auto keep = captured ? nova::KeepGradients::Leaves : nova::KeepGradients::All;
            EXPECT_EQ(gradients(model, config, forces, interval, captured, keep), all)
                << threads << " threads, interval " << interval << (captured ? ", captured" : "");
          }
    }
}

TEST(Rollout, TheGradientOfForcesIsThatOfTheDifferences) {
  const auto model = make_soft_body_model();
  const auto n = static_cast<size_t>(model->particle_count());
  const DeviceArray<Vec3f> forces = forces_over(kSteps * n, 1e-3f);
  const Gradients g = gradients(model, kSoft, forces, 7, false, nova::KeepGradients::All);
  std::vector<Vec3f> values = forces.to_host();
  for (const size_t row : {size_t{0}, 3 * n + 4, (kSteps / 2) * n + 1}) {
    float loss[2];
    const float h = 0.05f, before = values[row].z;
    for (const int side : {0, 1}) {
      values[row].z = before + (side ? h : -h);
      DeviceArray<Vec3f> moved = DeviceArray<Vec3f>::from_host(values);
      gradients(model, kSoft, moved, 1, false, nova::KeepGradients::All, &loss[side]);
    }
    values[row].z = before;
    const float expected = (loss[1] - loss[0]) / (2.0f * h);
    EXPECT_NEAR(g.forces[3 * row + 2], expected, 2e-2f * std::fabs(expected) + 2e-4f);
  }
  // The constant force acts in every step.
  double sum = 0.0;
  for (size_t t = 0; t < kSteps; ++t) sum += static_cast<double>(g.forces[3 * t * n + 2]);
  EXPECT_NEAR(g.constant[2], sum, 1e-4 * std::fabs(sum));
}

// Two controls over one rollout, or one for each half of the steps.
std::vector<float> activation_gradients(bool halves, int32_t interval, std::vector<Vec3f>& q) {
  const auto model = make_soft_body_model();
  DiffSemiImplicitSolver solver(model, kSoft);
  Control first = model->control(), second = model->control();
  second.particle_tet_activation.fill(0.1f);
  const Tensor a = diff::control_tet_activation_tensor(first, true),
               b = diff::control_tet_activation_tensor(second, true);
  Trajectory trajectory(model, kSteps, true, interval);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  if (halves) {
    solver.rollout(trajectory, &first, nullptr, kDt, {.stop = kSteps / 2});
    solver.rollout(trajectory, &second, nullptr, kDt, {.start = kSteps / 2});
  } else {
    solver.rollout(trajectory, nullptr, nullptr, kDt, {.controls = {&first, &second}});
  }
  const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
  tape.backward(nova::dot(last, last));
  q = trajectory.state(kSteps).particle_q.to_host();
  std::vector<float> g = a.grad().to_host();
  for (const float x : b.grad().to_host()) g.push_back(x);
  return g;
}

TEST(Rollout, ControlsOverTimeAreThoseOfItsParts) {
  std::vector<Vec3f> q, parts;
  const std::vector<float> whole = activation_gradients(false, 1, q);
  EXPECT_NE(whole, std::vector<float>(whole.size(), 0.0f));
  for (const int32_t interval : {1, 6}) {
    EXPECT_EQ(activation_gradients(true, interval, parts), whole);
    EXPECT_TRUE(same_bits<Vec3f>(parts, q));
  }
}

TEST(Rollout, RefusesWhatDoesNotFitByName) {
  const auto model = make_ball_model(2), other = make_ball_model(2);
  DiffSemiImplicitSolver solver(model, {.enable_static_contacts = true});
  Trajectory trajectory(model, 20, true, 8), strange(other, 20);
  const DeviceArray<Vec3f> forces = forces_over(5, 1.0f);
  const Control control = model->control();
  const auto run = [&](const RolloutOptions& options) {
    solver.rollout(trajectory, nullptr, nullptr, kDt, options);
  };
  EXPECT_ERROR(run({.forces = &forces}), ErrorKind::Value, "forces: expected {2, 3} or {20, 2, 3}");
  EXPECT_ERROR(run({.start = 3}), ErrorKind::Value, "state 3 is not kept, but those of t = 0, 8");
  EXPECT_ERROR(run({.stop = 21}), ErrorKind::Value, "0 <= start <= stop <= 20");
  EXPECT_ERROR(run({.controls = {&control, nullptr, &control}}), ErrorKind::Value,
               "divides the 20 steps, got 3");
  EXPECT_ERROR(solver.rollout(strange, nullptr, nullptr, kDt), ErrorKind::Value, "trajectory");
  EXPECT_ERROR(solver.rollout(trajectory, nullptr, nullptr, 0.0f), ErrorKind::Value, "dt");
  run({.stop = 8});
  EXPECT_ERROR(trajectory.recompute(9), ErrorKind::Runtime, "from state 0 to state 8");
}

TEST(Rollout, OnlyTheForceOfStateZeroCanBeWritten) {
  const auto model = make_ball_model(2);
  Trajectory trajectory(model, 3);
  const DeviceArray<Vec3f> force = forces_over(2, 1.0f);
  trajectory.state(0).particle_f.assign(force);
  SimState& later = trajectory.state(2);
  EXPECT_TRUE(same_bits<Vec3f>(later.particle_f.to_host(), force.to_host()));
  EXPECT_ERROR(later.particle_f.assign(force), ErrorKind::Runtime, "pass forces to rollout");
  EXPECT_ERROR(later.particle_f.mutable_data(), ErrorKind::Runtime, "forces");
  EXPECT_ERROR(later.particle_f.copy_from_host(force.to_host()), ErrorKind::Runtime, "forces");
  EXPECT_ERROR(later.clear_forces(), ErrorKind::Runtime, "forces");
  EXPECT_ERROR(diff::state_particle_f_tensor(later), ErrorKind::Runtime, "forces");
  DiffSemiImplicitSolver solver(model);
  EXPECT_ERROR(solver.step(later, trajectory.state(3), nullptr, nullptr, kDt), ErrorKind::Runtime,
               "forces");
  EXPECT_NO_THROW(trajectory.recompute(2).clear_forces());  // a copy of its own
}

TEST(Rollout, ATrajectoryHoldsEveryFieldOfAState) {
  const auto model = make_ball_model(4);
  const Trajectory trajectory(model, 6, true, 3);
  const std::vector<size_t> rows = StateFields::expected_rows(model->counts());
  std::set<std::string_view> applied;
  size_t k = 0;
  StateFields::visit(trajectory.fields(), [&](const FieldInfo& info, const Array& whole) {
    SCOPED_TRACE(info.name);
    EXPECT_NE(info.role, FieldRole::None);
    if (info.role == FieldRole::Applied) applied.insert(info.name);
    const size_t states = info.role == FieldRole::Carried ? 3 : 1;
    EXPECT_EQ(whole.rows(), states * rows[k]);
    size_t at = 0;
    StateFields::visit(trajectory.state(3), [&](const FieldInfo&, const Array& part) {
      if (at++ != k || part.bytes() == 0) return;
      EXPECT_EQ(part.rows(), rows[k]);
      EXPECT_TRUE(whole.range()->overlaps(*part.range()));
    });
    ++k;
  });
  EXPECT_EQ(applied, (std::set<std::string_view>{"particle_f", "body_f"}));
}

// Marks the solver as used, as a call in another thread would.
class BusySolver : public DiffSemiImplicitSolver {
 public:
  using DiffSemiImplicitSolver::DiffSemiImplicitSolver;
  using SolverBase::use;
};

TEST(Rollout, WhatRunsLaterTakesTheMemoryThatTheSolverKeeps) {
  for (const bool soft : {true, false}) {
    const auto model = soft ? make_soft_body_model() : make_ball_model(2);
    BusySolver solver(model, soft ? kSoft : diff::DiffSolverConfig{.enable_static_contacts = true});
    Trajectory trajectory(model, kSteps, true, 5);
    nova::ScopedCapture capture;
    solver.rollout(trajectory, nullptr, nullptr, kDt);
    capture.end();
    const Tensor q = diff::state_particle_q_tensor(trajectory.state(0), true);
    nova::Tape tape;
    Tensor loss;
    {
      const nova::TapeScope scope(tape);
      solver.rollout(trajectory, nullptr, nullptr, kDt);
      const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
      loss = nova::dot(last, last);
    }
    {
      const ExclusiveUse::Scope other = solver.use("step");
      if (soft) {
        EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "in use by another call");
        EXPECT_ERROR(capture.graph()->launch(), ErrorKind::Runtime, "in use by another call");
      } else {  // a step of balls writes only its states
        EXPECT_NO_THROW(tape.backward(loss));
        EXPECT_NO_THROW(capture.graph()->launch());
      }
    }
    EXPECT_NO_THROW(capture.graph()->launch());
  }
}

// A solver of one step, whose derivative is written by hand: qd' = c qd + dt f, q' = q + dt qd'.
class Drag : public diff::DiffSolverBase {
 public:
  using DiffSolverBase::DiffSolverBase;
  void step(SimState&, SimState&, const Control*, const Contacts*, float) override {}

 protected:
  bool begin_rollout(const RolloutInputs&) override { return true; }
  void record_step(const SimState& in, SimState& out, const diff::StepInputs& inputs,
                   StepScratch) override {
    const auto view = [](const Array& a) {
      return Tensor(a.range(), {static_cast<int64_t>(a.rows()), 3}, nova::DType::F32);
    };
    const Tensor q = view(in.particle_q), qd = view(in.particle_qd), q_out = view(out.particle_q),
                 qd_out = view(out.particle_qd),
                 f(inputs.forces.range, {inputs.forces.rows, 3}, nova::DType::F32);
    const float dt = inputs.dt, c = 0.875f;
    const nova::CustomOp op = {
        .name = "drag",
        .inputs = {q, qd, f},
        .outputs = {q_out, qd_out},
        .vjp =
            [=](std::span<const Tensor> g, std::span<const nova::InputGradient> in_g) {
              const Tensor none = nova::mul(qd, 0.0f), gq = g[0].defined() ? g[0] : none,
                           gqd = g[1].defined() ? g[1] : none,
                           by_qd = nova::add(gqd, nova::mul(gq, dt));
              if (in_g[0].wanted()) in_g[0].put(gq);
              if (in_g[1].wanted()) in_g[1].put(nova::mul(by_qd, c));
              if (in_g[2].wanted()) in_g[2].put(nova::mul(by_qd, dt));
            },
        .forward =
            [=] {
              qd_out.copy_(nova::add(nova::mul(qd, c), nova::mul(f, dt)));
              q_out.copy_(nova::add(q, nova::mul(qd_out, dt)));
            }};
    {
      const nova::NoGrad no_grad;
      op.forward();
    }
    if (nova::Tape* tape = nova::Tape::active()) tape->record_custom(op);
  }
};

TEST(Rollout, ASolverThatGivesOneStepIsCheckpointedAndCaptured) {
  const auto model = make_ball_model(3);
  const DeviceArray<Vec3f> forces = forces_over(kSteps * 3, 1.0f);
  Drag solver(model);
  const auto run = [&](int32_t interval, bool captured) {
    Trajectory trajectory(model, kSteps, true, interval);
    const Tensor qd = diff::state_particle_qd_tensor(trajectory.state(0), true),
                 u = tensor_of(forces);
    u.zero_grad();
    const auto iteration = [&] {
      nova::Tape tape;
      const nova::TapeScope scope(tape);
      solver.rollout(trajectory, nullptr, nullptr, kDt, {.forces = &forces});
      const Tensor last = diff::state_particle_q_tensor(trajectory.state(kSteps));
      tape.backward(nova::dot(last, last));
    };
    if (captured) {
      nova::ScopedCapture capture;
      iteration();
      capture.end();
      capture.graph()->launch();
    } else {
      iteration();
    }
    std::vector<float> result = qd.grad().to_host();
    for (const float x : u.grad().to_host()) result.push_back(x);
    for (const Vec3f& x : trajectory.recompute(7).particle_q.to_host()) result.push_back(x.z);
    return result;
  };
  const std::vector<float> all = run(1, false);
  // d q_end / d qd_0 = dt (c + c^2 + ... ), the same for all columns.
  Trajectory end(model, kSteps);
  solver.rollout(end, nullptr, nullptr, kDt, {.forces = &forces});
  double factor = 0.0, power = 1.0;
  for (int t = 0; t < kSteps; ++t) factor += kDt * (power *= 0.875);
  const float x = end.state(kSteps).particle_q.to_host()[0].z;
  EXPECT_NEAR(all[2], 2.0 * static_cast<double>(x) * factor, 1e-5);
  for (const int32_t interval : {2, 5, kSteps})
    for (const bool captured : {false, true}) EXPECT_EQ(run(interval, captured), all) << interval;
}

}  // namespace
}  // namespace novaphy::testing
