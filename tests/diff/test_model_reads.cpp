// How recorded and captured operations read a model: derived arrays follow their source, and a
// captured list knows the values that it contains.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::Tensor;

constexpr int32_t kSteps = 20;
constexpr float kDt = 1e-2f;

// Two particles and a spring above the ground; a force acts on one.
std::shared_ptr<Model> make_model() {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 0.08f}, {}, 1.0f);
  builder.add_particle({1.5f, 0.0f, 1.0f}, {}, 2.0f);
  builder.add_spring(0, 1, 30.0f, 0.5f, 0.0f);
  builder.add_ground_plane();
  return builder.finalize(Device::cpu());
}
diff::DiffSolverConfig config() { return {.enable_springs = true, .enable_static_contacts = true}; }

struct Pull {
  std::shared_ptr<Model> model = make_model();
  diff::DiffSemiImplicitSolver solver{model, config()};
  diff::Trajectory trajectory{model, kSteps};
  Tensor mass = diff::model_particle_mass_tensor(*model, true);

  Pull() {
    const std::vector<Vec3f> force = {{3.0f, 0.0f, 0.0f}, {}};
    DeviceArray<Vec3f> applied = trajectory.particle_f();
    applied.copy_from_host(std::span<const Vec3f>(force));
  }
  Tensor loss() {
    solver.rollout(trajectory, nullptr, nullptr, kDt);
    const Tensor q = diff::state_particle_q_tensor(trajectory.state(kSteps));
    return nova::dot(q, q);
  }
  Tensor train() {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    const Tensor l = loss();
    tape.backward(l);
    nova::sgd_update_f32(mass, 0.05f);
    tape.zero();
    return l;
  }
  std::vector<Vec3f> end() { return trajectory.state(kSteps).particle_q.to_host(); }
};

TEST(Mass, OfAParticleHasTheGradientOfDifferences) {
  Pull pull;
  const auto result =
      nova::gradcheck([&](const std::vector<Tensor>&) { return pull.loss(); }, {pull.mass},
                      {.epsilon = 1e-2f, .rtol = 1e-2f, .atol = 1e-4f});
  EXPECT_TRUE(result.ok) << result.worst << ", relative " << result.max_rel_error;
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  tape.backward(pull.loss());
  EXPECT_NE(pull.mass.grad().to_host()[0], 0.0f);
}

TEST(Mass, ThatIsAssignedActsAtTheNextStepOfEverySolver) {
  const std::vector<float> masses = {3.0f, 0.7f};
  const auto after = [&](const auto& make_solver, bool assigned_first) {
    const auto model = make_model();
    if (assigned_first) model->particle_mass.copy_from_host(std::span<const float>(masses));
    const auto solver = make_solver(model);
    SimState a = model->state(), b = model->state();
    solver->step(a, b, nullptr, nullptr, kDt);
    model->particle_mass.copy_from_host(std::span<const float>(masses));
    a = model->state();
    solver->step(a, b, nullptr, nullptr, kDt);
    return b.particle_qd.to_host();
  };
  const auto differentiable = [](const auto& model) {
    return std::make_unique<diff::DiffSemiImplicitSolver>(model, config());
  };
  const auto forward = [](const auto& model) {
    return std::make_unique<SolverSemiImplicit>(model);
  };
  EXPECT_TRUE(same_bits<Vec3f>(after(differentiable, false), after(differentiable, true)));
  EXPECT_TRUE(same_bits<Vec3f>(after(forward, false), after(forward, true)));
}

TEST(Mass, InTheOperatorActsToo) {
  const auto model = make_model();
  model->particle_mass.fill(4.0f);
  const Tensor f = Tensor::full({2, 3}, 8.0f);
  const auto [q, qd] = diff::integrate_particles_generated(
      *model, Tensor::view(model->particle_q), Tensor::view(model->particle_qd), f, 0.5f);
  EXPECT_EQ(qd.to_host()[0], 1.0f);
}

TEST(Mass, TrainedInACaptureHasTheBitsOfTrainingStepByStep) {
  Pull now;
  std::vector<float> losses;
  for (int k = 0; k < 4; ++k) losses.push_back(now.train().item());
  EXPECT_NE(losses[0], losses[3]);
  const std::vector<Vec3f> end = now.end();
  const float after = now.loss().item();
  for (const int count : {1, 2, 7}) {
    const Threads threads(count);
    Pull later;
    Tensor loss;
    nova::ScopedCapture capture;
    loss = later.train();
    capture.end();
    for (const float expected : losses) {
      capture.graph()->launch();
      EXPECT_EQ(loss.item(), expected);
    }
    EXPECT_TRUE(same_bits<Vec3f>(later.end(), end));
    EXPECT_TRUE(same_bits<float>(later.mass.to_host(), now.mass.to_host()));
    // A step outside of the list follows the change too.
    EXPECT_EQ(later.loss().item(), after);
  }
}

TEST(Mass, ThatAListWritesFirstActsInTheSameLaunch) {
  Pull pull;
  const Tensor heavy = Tensor::full({2}, 5.0f);
  nova::ScopedCapture capture;
  pull.mass.copy_(heavy);
  pull.solver.rollout(pull.trajectory, nullptr, nullptr, kDt);
  capture.end();
  capture.graph()->launch();
  Pull expected;
  expected.model->particle_mass.fill(5.0f);
  expected.loss();
  EXPECT_TRUE(same_bits<Vec3f>(pull.end(), expected.end()));
}

TEST(Mass, AssignedBetweenLaunchesActsAtTheNext) {
  Pull pull;
  nova::ScopedCapture capture;
  pull.solver.rollout(pull.trajectory, nullptr, nullptr, kDt);
  capture.end();
  capture.graph()->launch();
  pull.model->particle_mass.fill(5.0f);
  capture.graph()->launch();
  Pull expected;
  expected.model->particle_mass.fill(5.0f);
  expected.loss();
  EXPECT_TRUE(same_bits<Vec3f>(pull.end(), expected.end()));
}

TEST(Mass, AnInverseThatWasAssignedStaysThroughLaunches) {
  Pull pull;
  pull.model->particle_inv_mass.fill(0.0f);
  nova::ScopedCapture capture;
  pull.solver.rollout(pull.trajectory, nullptr, nullptr, kDt);
  capture.end();
  capture.graph()->launch();
  EXPECT_TRUE(same_bits<Vec3f>(pull.end(), pull.model->particle_q.to_host()));
}

// Every number of a model is one that a launch compares.
TEST(CapturedNumbers, ThatChangedAreRefusedByNameAndActAgainWhenSetBack) {
  float ModelNumbers::*const numbers[] = {
      &ModelNumbers::soft_contact_ke,   &ModelNumbers::soft_contact_kd,
      &ModelNumbers::soft_contact_kf,   &ModelNumbers::soft_contact_mu,
      &ModelNumbers::particle_adhesion, &ModelNumbers::particle_max_velocity};
  const char* const names[] = {"soft_contact_ke", "soft_contact_kd",   "soft_contact_kf",
                               "soft_contact_mu", "particle_adhesion", "particle_max_velocity"};
  Pull pull;
  nova::ScopedCapture capture;
  pull.solver.rollout(pull.trajectory, nullptr, nullptr, kDt);
  capture.end();
  capture.graph()->launch();
  const std::vector<Vec3f> before = pull.end();
  for (size_t k = 0; k < std::size(numbers); ++k) {
    float& number = (*pull.model).*numbers[k];
    const float recorded = number;
    number = 0.125f;
    EXPECT_ERROR(capture.graph()->launch(), ErrorKind::Runtime,
                 "model." + std::string(names[k]) + ": recorded as");
    EXPECT_TRUE(same_bits<Vec3f>(pull.end(), before)) << "nothing ran";
    number = recorded;
    capture.graph()->launch();
  }
}

TEST(CapturedNumbers, OfAModelOutliveIt) {
  std::shared_ptr<nova::OpList> graph;
  {
    Pull pull;
    nova::ScopedCapture capture;
    pull.solver.rollout(pull.trajectory, nullptr, nullptr, kDt);
    graph = capture.graph();
  }
  graph->launch();
}

TEST(CapturedNumbers, ThatMakeNoSenseAreRefusedBeforeARolloutRuns) {
  Pull pull;
  pull.model->soft_contact_mu = -1.0f;
  EXPECT_ERROR(pull.loss(), ErrorKind::Value,
               "DiffSemiImplicitSolver.rollout: model.soft_contact_mu: expected a finite number");
}

}  // namespace
}  // namespace novaphy::testing
