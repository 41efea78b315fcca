#include <gtest/gtest.h>

#include <cmath>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/planar_arm.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

// The planar arm of tests/golden/newton_2r_strict.npz.
std::shared_ptr<Model> arm() {
  ModelBuilder b;
  const BodyArgs link{
      .mass = 1.0f,
      .inertia = Mat33f{{{0.0025f, 0, 0}, {0, 1.0f / 48.0f, 0}, {0, 0, 1.0f / 48.0f}}},
      .lock_inertia = true};
  const int32_t body[2] = {b.add_link(link), b.add_link(link)};
  const JointDofConfig dof{.axis = {0, 1, 0}};
  const Transformf in_child = {{-0.25f, 0, 0}, Quatf::identity()};
  const int32_t joints[2] = {
      b.add_joint_revolute(-1, body[0], {.child_xform = in_child, .dof = dof}),
      b.add_joint_revolute(body[0], body[1],
                           {.parent_xform = {{0.25f, 0, 0}, Quatf::identity()},
                            .child_xform = in_child,
                            .dof = dof})};
  b.add_articulation(joints);
  b.joint_q = {0.4f, -0.6f};
  b.joint_qd = {1.0f, -0.5f};
  return b.finalize(Device::cpu(), {.requires_grad = true});
}

struct Result {
  float loss;
  std::vector<float> qd, q;
};
Result throw_arm(float damping, int32_t checkpoint) {
  const auto model = arm();
  DiffFeatherstoneSolver solver(model, {.angular_damping = damping});
  Trajectory trajectory(model, 576, true, checkpoint);
  nova::Tape tape;
  nova::Tensor loss;
  {
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, nullptr, 1.0f / 960.0f);
    loss = planar_2r_tip_loss(*model, state_joint_q_tensor(trajectory.state(576)), 0.35f, -0.75f);
  }
  tape.backward(loss);
  const SimState& start = trajectory.state(0);
  const auto numbers = [](const nova::Tensor& t) {
    return std::vector<float>(t.data<float>(), t.data<float>() + t.size());
  };
  return {loss.data<float>()[0], numbers(state_joint_qd_tensor(start).grad()),
          numbers(state_joint_q_tensor(start).grad())};
}

// Exact values, in double precision.
TEST(DiffFeatherstone, TheArmsRolloutHasTheExactGradient) {
  const Result free = throw_arm(0.0f, 1), damped = throw_arm(0.05f, 1);
  EXPECT_NEAR(free.loss, 1.09098f, 1e-4f);
  EXPECT_NEAR(free.qd[0], 0.32981f, 1e-4f);
  EXPECT_NEAR(free.qd[1], 0.11073f, 1e-4f);
  EXPECT_NEAR(damped.loss, 1.06486f, 1e-4f);
  EXPECT_NEAR(damped.qd[0], 0.31791f, 1e-4f);
  EXPECT_NEAR(damped.qd[1], 0.10408f, 1e-4f);
}

TEST(DiffFeatherstone, CheckpointsGiveTheSameBits) {
  const Result all = throw_arm(0.05f, 1), kept = throw_arm(0.05f, 24);
  EXPECT_EQ(all.loss, kept.loss);
  EXPECT_EQ(all.qd, kept.qd);
  EXPECT_EQ(all.q, kept.q);
}

// <J x, y> = <x, J^T y> through some steps of the tape.
TEST(DiffFeatherstone, TheTangentIsTheTransposeOfTheGradient) {
  const auto model = arm();
  DiffFeatherstoneSolver solver(model);
  Trajectory trajectory(model, 20);
  nova::Tape tape;
  const nova::Tensor q = state_joint_q_tensor(trajectory.state(0)),
                     mass = model_body_mass_tensor(*model, true);
  {
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, nullptr, 0.01f);
  }
  const nova::Tensor end = state_body_q_tensor(trajectory.state(20));
  const std::vector<float> x = {0.3f, -0.7f}, m = {0.2f, 0.5f};
  std::vector<float> y(14);
  for (size_t i = 0; i < y.size(); ++i) y[i] = std::cos(static_cast<float>(i));
  const auto tensor = [](const std::vector<float>& v, nova::Shape shape) {
    return nova::Tensor::from_host(std::span<const float>(v), std::move(shape));
  };
  const nova::Tensor tangent = tape.jvp({end}, {q, mass}, {tensor(x, {2}), tensor(m, {2})})[0];
  tape.backward(end, tensor(y, {2, 7}));
  double forward = 0.0, reverse = 0.0;
  for (size_t i = 0; i < 14; ++i) forward += y[i] * tangent.data<float>()[i];
  for (size_t i = 0; i < 2; ++i)
    reverse += x[i] * q.grad().data<float>()[i] + m[i] * mass.grad().data<float>()[i];
  EXPECT_NEAR(forward, reverse, 1e-5 * (1.0 + std::abs(forward)));
  EXPECT_GT(std::abs(forward), 0.01);
}

}  // namespace
}  // namespace novaphy::diff
