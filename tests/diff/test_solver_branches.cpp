// The differentiable solver on scenes with branches that the ball does not reach (see
// tools/reference/make_newton_branches.py). The forward run has the same bits as Newton, and the
// gradients agree closely.
#include <gtest/gtest.h>

#include <cmath>

#include "dynamics/golden_scene.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy::testing {
namespace {

using nova::Tensor;

struct Scene {
  explicit Scene(const std::string& name)
      : file(golden("newton_" + name + ".npz")),
        model(golden_model(file)),
        solver(model, {.contact_gradient = diff::DerivativeOf::Code}),  // as Newton
        pipeline(model, {.soft_contact_margin = file["soft_contact_gap"].scalar<float>()}),
        contacts(pipeline.contacts()),
        steps(file["sim_steps"].scalar<int32_t>()),
        dt(file["sim_dt"].scalar<float>()) {
    for (int t = 0; t <= steps; ++t) states.push_back(model->state());
    pipeline.collide(states[0], contacts);
  }

  void forward() {
    for (int t = 0; t < steps; ++t) {
      states[t].clear_forces();
      solver.step(states[t], states[t + 1], nullptr, &contacts, dt);
    }
  }
  // The sum over the particles of |x_end - target|^2.
  Tensor loss() {
    const Tensor q = diff::state_particle_q_tensor(states.back());
    std::vector<Vec3f> targets(static_cast<size_t>(model->particle_count()),
                               file["target"].as<Vec3f>()[0]);
    const Tensor target = Tensor::from_host(
        std::span(reinterpret_cast<const float*>(targets.data()), targets.size() * 3), q.shape());
    const Tensor away = nova::sub(q, target);
    return nova::dot(away, away);
  }

  Npz file;
  std::shared_ptr<Model> model;
  diff::DiffSemiImplicitSolver solver;
  CollisionPipeline pipeline;
  Contacts contacts;
  int steps;
  float dt;
  std::vector<SimState> states;
};

class Branches : public ::testing::TestWithParam<const char*> {};

TEST_P(Branches, StatesAndForcesEqualNewtonToTheBit) {
  Scene scene(GetParam());
  scene.forward();
  const auto n = static_cast<size_t>(scene.model->particle_count());
  for (int t = 0; t <= scene.steps; ++t) {
    const size_t row = static_cast<size_t>(t) * n;
    EXPECT_TRUE(same_bits<Vec3f>(scene.states[t].particle_q.to_host(),
                                 scene.file["particle_q"].as<Vec3f>().subspan(row, n)))
        << "positions of state " << t;
    EXPECT_TRUE(same_bits<Vec3f>(scene.states[t].particle_qd.to_host(),
                                 scene.file["particle_qd"].as<Vec3f>().subspan(row, n)))
        << "velocities of state " << t;
    if (t == scene.steps) break;
    EXPECT_TRUE(same_bits<Vec3f>(scene.states[t].particle_f.to_host(),
                                 scene.file["particle_f"].as<Vec3f>().subspan(row, n)))
        << "forces of state " << t;
  }
}

TEST_P(Branches, GradientsOfTheInitialStateEqualNewton) {
  Scene scene(GetParam());
  const Tensor q = diff::state_particle_q_tensor(scene.states[0], true);
  const Tensor qd = diff::state_particle_qd_tensor(scene.states[0], true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  scene.forward();
  tape.backward(scene.loss());
  // Newton leaves friction out of the gradient of a particle at rest, the first one of that scene.
  const size_t first = std::string(GetParam()) == "friction" ? 3 : 0;
  auto compare = [first](const std::vector<float>& actual, std::span<const float> expected) {
    ASSERT_EQ(actual.size(), expected.size());
    double error = 0.0, norm = 0.0;
    for (size_t k = first; k < actual.size(); ++k) {
      error += std::pow(static_cast<double>(actual[k]) - static_cast<double>(expected[k]), 2);
      norm += std::pow(static_cast<double>(expected[k]), 2);
    }
    EXPECT_LE(std::sqrt(error), 1e-5 * std::sqrt(norm));
  };
  compare(q.grad().to_host(), scene.file["grad_q"].as<float>());
  compare(qd.grad().to_host(), scene.file["grad_qd"].as<float>());
}

TEST(FrictionBranch, OfAParticleAtRestHasTheGradientOfDifferences) {
  Scene scene("friction");
  const Tensor qd = diff::state_particle_qd_tensor(scene.states[0], true);
  {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    scene.forward();
    tape.backward(scene.loss());
  }
  const std::vector<float> gradient = qd.grad().to_host();
  // Along y, where the particle is at 0 and rounding does not remove the differences.
  const float target = scene.file["target"].as<Vec3f>()[0].y;
  const auto loss_at = [&](float v) {
    std::vector<float> start(qd.to_host());
    start[1] = v;
    qd.copy_from_host(start.data(), start.size() * sizeof(float));
    scene.forward();
    const double away = static_cast<double>(scene.states.back().particle_q.to_host()[0].y) -
                        static_cast<double>(target);
    return away * away;
  };
  constexpr float kEps = 1e-2f;
  const double fd = (loss_at(kEps) - loss_at(-kEps)) / (2.0 * static_cast<double>(kEps));
  EXPECT_NEAR(gradient[1], fd, 1e-2 * std::fabs(fd));
  // Newton returns 50 times as much, as if there were no friction.
  EXPECT_LT(std::fabs(fd),
            0.05 * std::fabs(static_cast<double>(scene.file["grad_qd"].as<float>()[1])));
  // Friction reduces the gradient by the same factor in all directions, relative to no friction.
  const auto free = scene.file["grad_qd"].as<float>();
  EXPECT_NEAR(gradient[0] / free[0], gradient[1] / free[1], 1e-6f);
}

// The scene finite_plane is left out. Newton's distance is unsigned there, and its contact geometry
// is on the wrong side below and beside the sheet. tests/dynamics/test_newton_branches.cpp compares
// the valid part of that scene.
INSTANTIATE_TEST_SUITE_P(Newton, Branches,
                         ::testing::Values("friction", "tilted", "box_interior", "walls",
                                           "velocity_clamp", "inactive", "shape_flags",
                                           "sphere_capsule"),
                         [](const auto& scene) { return std::string(scene.param); });

}  // namespace
}  // namespace novaphy::testing
