// The results have the same bits for any number of threads, for direct, recorded and replayed runs,
// and in every process and thread.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <thread>

#include "diff/ball_scene.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::Tensor;

struct Result {
  std::vector<Vec3f> q;
  std::vector<float> grad_q, grad_qd, grad_ke;
  float loss = 0.0f;
  bool operator==(const Result&) const = default;
};

enum class Way { StepLoop, Rollout, Captured };

Result run(int balls, Way way, int steps = 60,
           nova::KeepGradients keep = nova::KeepGradients::All) {
  const auto model = make_ball_model(balls);
  // Captures have the derivative of the code.
  diff::DiffSemiImplicitSolver solver(model, {.contact_gradient = diff::DerivativeOf::Code});
  diff::Trajectory trajectory(model, steps);
  std::vector<SimState> states;
  if (way == Way::StepLoop)
    for (int t = 0; t <= steps; ++t) states.push_back(model->state());
  auto state = [&](int t) -> SimState& {
    return way == Way::StepLoop ? states[static_cast<size_t>(t)] : trajectory.state(t);
  };
  const Contacts contacts = make_ball_contacts(model, state(0));
  const Tensor q0 = diff::state_particle_q_tensor(state(0), true),
               qd0 = diff::state_particle_qd_tensor(state(0), true);
  const Tensor ke = diff::model_shape_material_ke_tensor(*model, true);
  Tensor loss;
  auto iteration = [&] {
    nova::Tape tape(keep);
    const nova::TapeScope scope(tape);
    if (way == Way::StepLoop) {
      for (int t = 0; t < steps; ++t)
        solver.step(state(t), state(t + 1), nullptr, &contacts, 4.0f * kBallDt);
    } else {
      solver.rollout(trajectory, nullptr, &contacts, 4.0f * kBallDt);
    }
    const Tensor q = diff::state_particle_q_tensor(state(steps));
    loss = nova::dot(q, q);
    tape.backward(loss);
  };
  if (way == Way::Captured) {
    nova::ScopedCapture capture;
    iteration();
    capture.end();
    capture.graph()->prepare();
    capture.graph()->launch();
  } else {
    iteration();
  }
  if (keep == nova::KeepGradients::Leaves) {  // gradients of states in between take no memory
    for (int t = 1; t <= steps; ++t)
      EXPECT_EQ(nova::grad_info(*state(t).particle_qd.range()).grad, nullptr) << t;
  }
  Result result;
  for (int t = 0; t <= steps; ++t)
    for (const Vec3f& x : state(t).particle_q.to_host()) result.q.push_back(x);
  result.grad_q = q0.grad().to_host();
  result.grad_qd = qd0.grad().to_host();
  result.grad_ke = ke.grad().to_host();
  result.loss = loss.item();
  return result;
}

void expect_same(const Result& actual, const Result& expected) {
  EXPECT_TRUE(same_bits<Vec3f>(actual.q, expected.q));
  EXPECT_TRUE(same_bits<float>(actual.grad_q, expected.grad_q));
  EXPECT_TRUE(same_bits<float>(actual.grad_qd, expected.grad_qd));
  EXPECT_TRUE(same_bits<float>(actual.grad_ke, expected.grad_ke));
  EXPECT_EQ(actual.loss, expected.loss);
}

// Sizes that run lane by lane, in one block, and in several blocks.
class Determinism : public ::testing::TestWithParam<int> {};

TEST_P(Determinism, AnyNumberOfThreadsGivesTheSameBits) {
  const Result expected = [&] {
    const Threads one(1);
    return run(GetParam(), Way::Rollout);
  }();
  for (int threads : {2, 7}) {
    const Threads scope(threads);
    expect_same(run(GetParam(), Way::Rollout), expected);
  }
}

TEST_P(Determinism, EveryWayOfRunningGivesTheSameBits) {
  const Result rollout = run(GetParam(), Way::Rollout);
  expect_same(run(GetParam(), Way::Rollout), rollout);
  expect_same(run(GetParam(), Way::Captured), rollout);
  for (const Way way : {Way::Rollout, Way::Captured})
    expect_same(run(GetParam(), way, 60, nova::KeepGradients::Leaves), rollout);
  // If a particle met several shapes at once, the loop would sum the terms of its gradient in
  // another order. No particle of the scene does.
  expect_same(run(GetParam(), Way::StepLoop), rollout);
}

INSTANTIATE_TEST_SUITE_P(Balls, Determinism, ::testing::Values(1, 3, 100, 2047, 2048, 5001));

TEST(Determinism, OneBallOfManyHasTheBitsOfOneBallAlone) {
  const Result one = run(1, Way::Rollout), many = run(2500, Way::Rollout);
  for (size_t t = 0; t < one.q.size(); ++t) {
    EXPECT_EQ(many.q[t * 2500 + 3].y, one.q[t].y);  // ball 3 stands at x = 0 too
    EXPECT_EQ(many.q[t * 2500 + 3].z, one.q[t].z);
  }
}

TEST(Determinism, TwoThreadsWithATapeEachGiveTheSameBits) {
  const Result expected = run(300, Way::Rollout);
  Result results[2];
  {
    std::thread first([&] { results[0] = run(300, Way::Rollout); });
    std::thread second([&] { results[1] = run(300, Way::Rollout); });
    first.join();
    second.join();
  }
  for (const Result& result : results) expect_same(result, expected);
}

TEST(Determinism, AForkedChildGivesTheSameBits) {
  const Threads scope(2);
  const Result expected = run(5000, Way::Rollout, 10);  // creates the threads before the fork
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) _exit(run(5000, Way::Rollout, 10) == expected ? 0 : 1);
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

}  // namespace
}  // namespace novaphy::testing
