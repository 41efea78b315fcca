// The ball against Newton: every state, force, loss and contact has the same bits. The gradient and
// the training agree closely.
#include <gtest/gtest.h>

#include <cmath>

#include "diff/ball_scene.h"
#include "novaphy/core/parallel.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy::testing {
namespace {

using diff::DiffSemiImplicitSolver;
using nova::Tape;
using nova::TapeScope;
using nova::Tensor;

class Ball : public ::testing::Test {
 protected:
  // Newton's gradient is that of the steps.
  Ball() : model(make_ball_model()), solver(model, {.contact_gradient = diff::DerivativeOf::Code}) {
    for (int t = 0; t <= kBallSteps; ++t) states.push_back(model->state());
    contacts.emplace(make_ball_contacts(model, states[0]));
  }

  Tensor loss_of(const SimState& last) {
    return diff::particle_point_loss_generated(diff::state_particle_q_tensor(last), 0,
                                               kBallTarget.x, kBallTarget.y, kBallTarget.z);
  }
  Tensor forward() {
    for (int t = 0; t < kBallSteps; ++t) {
      states[t].clear_forces();
      solver.step(states[t], states[t + 1], nullptr, &*contacts, kBallDt);
    }
    return loss_of(states.back());
  }
  template <class F>
  std::vector<Vec3f> all(F field) {
    std::vector<Vec3f> values;
    for (const SimState& s : states)
      for (const Vec3f& v : field(s)) values.push_back(v);
    return values;
  }

  std::shared_ptr<Model> model;
  DiffSemiImplicitSolver solver;
  std::vector<SimState> states;
  std::optional<Contacts> contacts;
  Npz reference{NOVAPHY_GOLDEN_DIR "/newton_ball_strict.npz"};
};

TEST_F(Ball, StatesForcesAndLossEqualNewtonToTheBit) {
  const float loss = forward().item();
  // The last state's force is never computed.
  EXPECT_TRUE(same_bits<Vec3f>(all([](const SimState& s) { return s.particle_q.to_host(); }),
                               reference["particle_q"].as<Vec3f>()));
  EXPECT_TRUE(same_bits<Vec3f>(all([](const SimState& s) { return s.particle_qd.to_host(); }),
                               reference["particle_qd"].as<Vec3f>()));
  const auto forces = all([](const SimState& s) { return s.particle_f.to_host(); });
  EXPECT_TRUE(same_bits<Vec3f>(std::span(forces).first(kBallSteps),
                               reference["particle_f"].as<Vec3f>().first(kBallSteps)));
  EXPECT_EQ(loss, reference["loss"].scalar<float>());
}

TEST_F(Ball, GradientEqualsNewton) {
  const Tensor qd = diff::state_particle_qd_tensor(states[0], true);
  diff::state_particle_q_tensor(states[0], true);
  Tape tape;
  TapeScope scope(tape);
  const Tensor loss = forward();
  EXPECT_EQ(tape.size(), 2u * kBallSteps + 1u);
  tape.backward(loss);
  const auto grad = qd.grad().to_host();
  const auto expected = reference["grad_ad"].as<float>();
  for (int k = 0; k < 3; ++k)
    EXPECT_NEAR(grad[k], expected[k], 1e-6f * std::fabs(expected[1])) << k;
  const auto adj_q = reference["adj_q"].as<Vec3f>();
  const auto g = diff::state_particle_q_tensor(states[0]).grad().to_host();
  EXPECT_NEAR(g[1], adj_q[0].y, 1e-6f * std::fabs(adj_q[0].y));
  EXPECT_NEAR(g[2], adj_q[0].z, 1e-6f * std::fabs(adj_q[0].y));
}

TEST_F(Ball, TrainingFollowsNewton) {
  const Tensor qd = diff::state_particle_qd_tensor(states[0], true);
  const auto train_loss = reference["train_loss"].as<float>();
  const auto train_vel = reference["train_vel"].as<Vec3f>();
  for (size_t k = 0; k < train_loss.size(); ++k) {
    const auto v = qd.to_host();
    EXPECT_NEAR(v[1], train_vel[k].y, 1e-5f) << k;
    EXPECT_NEAR(v[2], train_vel[k].z, 1e-5f) << k;
    Tape tape;
    TapeScope scope(tape);
    const Tensor loss = forward();
    EXPECT_NEAR(loss.item(), train_loss[k], 1e-5f * train_loss[k]) << k;
    tape.backward(loss);
    nova::sgd_update_f32(qd, kBallRate);
    tape.zero();
  }
}

TEST_F(Ball, RolloutAndReplayHaveTheBitsOfTheStepLoop) {
  const Tensor qd = diff::state_particle_qd_tensor(states[0], true);
  std::vector<float> step_grad;
  {
    Tape tape;
    TapeScope scope(tape);
    tape.backward(forward());
    step_grad = qd.grad().to_host();
  }
  diff::Trajectory trajectory(model, kBallSteps);
  const Tensor v0 = diff::state_particle_qd_tensor(trajectory.state(0), true);
  auto iteration = [&] {
    Tape tape;
    TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, &*contacts, kBallDt);
    const Tensor loss = loss_of(trajectory.state(kBallSteps));
    tape.backward(loss);
    nova::sgd_update_f32(v0, kBallRate);
    tape.zero();
    return loss;
  };
  std::shared_ptr<nova::OpList> graph;
  Tensor loss;
  {
    nova::ScopedCapture capture;
    loss = iteration();
    graph = capture.graph();
  }
  graph->prepare();
  const auto train_loss = reference["train_loss"].as<float>();
  for (size_t k = 0; k < train_loss.size(); ++k) {
    graph->launch();
    EXPECT_NEAR(loss.item(), train_loss[k], 1e-5f * train_loss[k]) << k;
    if (k == 0) {
      EXPECT_TRUE(
          same_bits<Vec3f>(trajectory.particle_q().to_host(), reference["particle_q"].as<Vec3f>()));
    }
  }
  const auto expected = reference["train_final_vel"].as<float>();
  EXPECT_NEAR(v0.to_host()[1], expected[1], 1e-5f);
  EXPECT_NEAR(v0.to_host()[2], expected[2], 1e-5f);
}

TEST_F(Ball, GradientAgreesWithCentralDifferences) {
  const Tensor qd = diff::state_particle_qd_tensor(states[0], true);
  {
    Tape tape;
    TapeScope scope(tape);
    tape.backward(forward());
  }
  const auto grad = qd.grad().to_host();
  nova::NoGrad no_grad;
  const std::vector<float> v = qd.to_host();
  // The step that Newton's example takes: a larger one opens and closes contacts inside the
  // difference.
  const float eps = 1e-3f;
  double largest = 0.0, error = 0.0;
  for (int k = 0; k < 3; ++k) {
    auto moved = v;
    moved[k] = v[k] + eps;
    qd.copy_from_host(moved.data(), 12);
    const double up = forward().item();
    moved[k] = v[k] - eps;
    qd.copy_from_host(moved.data(), 12);
    const double down = forward().item();
    const double fd = (up - down) / (2.0 * static_cast<double>(eps));
    largest = std::max(largest, std::fabs(fd));
    error = std::max(error, std::fabs(static_cast<double>(grad[k]) - fd));
  }
  EXPECT_LE(error / largest, 3e-3);
}

}  // namespace
}  // namespace novaphy::testing
