// Contacts of particles on a tape: friction at rest, where the law is smooth although the unit
// vector and the length of the slip velocity are not.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/sim/model_builder.h"
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

constexpr float kKe = 1e3f, kKd = 10.0f, kKf = 10.0f, kMu = 0.5f, kRadius = 0.1f;

// Particles 1 cm deep in a plane through the origin, turned by `q`.
std::shared_ptr<Model> make_model(const std::vector<Vec3f>& velocities, const Quatf& q,
                                  float mu = kMu) {
  ModelBuilder builder;
  const ShapeConfig cfg{.ke = kKe, .kd = kKd, .kf = kKf, .mu = mu};
  Transformf xform;
  xform.q = q;
  builder.add_shape_plane({.xform = xform, .cfg = cfg});
  const Vec3f deep = math::rotate(q, Vec3f{0.0f, 0.0f, kRadius - 0.01f});
  for (const Vec3f& v : velocities) builder.add_particle(deep, v, 1.0f, kRadius);
  auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = kKe;
  model->soft_contact_kd = kKd;
  model->soft_contact_kf = kKf;
  model->soft_contact_mu = mu;
  return model;
}

// d(w f)/dv of one particle by the tape, for the force f of its contact.
Vec3f velocity_gradient(const Model& model, const Vec3f& w) {
  const Tensor qd = Tensor::view(model.particle_qd, true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  const Tensor f = diff::eval_static_particle_shape_contact_forces_generated(
      model, Tensor::view(model.particle_q), qd, Tensor({1, 3}));
  tape.backward(f, Tensor::from_host(std::span(&w.x, 3), {1, 3}));
  const std::vector<float> g = qd.grad().to_host();
  return {g[0], g[1], g[2]};
}

// Returns the gradient of the viscous friction -kf (1 - n nT) v.
Vec3f expected_gradient(const Vec3f& n, const Vec3f& w) { return (w - n * math::dot(n, w)) * -kKf; }

void expect_near(const Vec3f& a, const Vec3f& b) {
  EXPECT_NEAR(a.x, b.x, 1e-5f);
  EXPECT_NEAR(a.y, b.y, 1e-5f);
  EXPECT_NEAR(a.z, b.z, 1e-5f);
}

const Quatf kTilted = {std::sin(0.2f), 0.0f, 0.0f, std::cos(0.2f)};
const Vec3f kSeed = {0.7f, -1.3f, 0.4f};

TEST(FrictionAtRest, HasTheDerivativeOfViscousFriction) {
  for (const Quatf& q : {Quatf::identity(), kTilted}) {
    const Vec3f n = math::rotate(q, Vec3f{0.0f, 0.0f, 1.0f});
    // At rest, leaving along the normal, and so slow that |vt|^2 underflows.
    for (const Vec3f& v : {Vec3f{}, Vec3f{-0.0f, 0.0f, -0.0f}, n * 1e-30f, Vec3f{1e-30f, 0, 0}})
      expect_near(velocity_gradient(*make_model({v}, q), kSeed), expected_gradient(n, kSeed));
  }
  // An approach along the normal is damped as well.
  const Vec3f down = {0.0f, 0.0f, -0.3f}, z = {0.0f, 0.0f, 1.0f};
  expect_near(velocity_gradient(*make_model({down}, Quatf::identity()), kSeed),
              expected_gradient(z, kSeed) - z * (kKd * kSeed.z));
}

TEST(FrictionAtRest, IsTheLimitOfTheDerivativeInMotion) {
  const Vec3f at_rest = velocity_gradient(*make_model({Vec3f{}}, kTilted), kSeed);
  const Vec3f slow = velocity_gradient(*make_model({Vec3f{1e-6f, 0.0f, 0.0f}}, kTilted), kSeed);
  expect_near(at_rest, slow);
}

TEST(FrictionAtRest, WithoutACoulombLimitPassesNothing) {
  expect_near(velocity_gradient(*make_model({Vec3f{}}, Quatf::identity(), 0.0f), kSeed), Vec3f{});
}

TEST(FrictionAtRest, PassesNothingToItsCoefficients) {
  const auto model = make_model({Vec3f{}}, Quatf::identity());
  const Tensor kf = diff::model_shape_material_kf_tensor(*model, true),
               mu = diff::model_shape_material_mu_tensor(*model, true),
               ke = diff::model_shape_material_ke_tensor(*model, true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  const Tensor f = diff::eval_static_particle_shape_contact_forces_generated(
      *model, Tensor::view(model->particle_q), Tensor::view(model->particle_qd), Tensor({1, 3}));
  tape.backward(f, Tensor::from_host(std::span(&kSeed.x, 3), {1, 3}));
  EXPECT_EQ(kf.grad().to_host()[0], 0.0f);
  EXPECT_EQ(mu.grad().to_host()[0], 0.0f);
  EXPECT_NEAR(ke.grad().to_host()[0], 0.5f * 0.01f * kSeed.z, 1e-6f);  // the spring's
}

TEST(FrictionAtRest, TracedHasTheBitsOfTheForwardLaw) {
  const std::vector<float> edges = {0.0f,    -0.0f,  1e-45f, -1e-45f, 1e-30f,
                                    -1e-20f, 1e-10f, -0.5f,  3.0f,    1e20f};
  std::vector<Vec3f> velocities;
  for (const float x : edges)
    for (const float y : edges) velocities.push_back({x, y, y});
  const auto model = make_model(velocities, Quatf::identity());
  std::vector<Vec3f> expected;
  const SoftContactMaterial<float> material = {kKe, kKd, kKf, kMu};
  for (const Vec3f& v : velocities)
    expected.push_back(Vec3f{} + soft_contact_force_term(model->particle_q.to_host()[0], v, kRadius,
                                                         Vec3f{}, Vec3f{}, Vec3f{0.0f, 0.0f, 1.0f},
                                                         material, 0.0f));
  const Tensor f = diff::eval_static_particle_shape_contact_forces_generated(
      *model, Tensor::view(model->particle_q), Tensor::view(model->particle_qd),
      Tensor({static_cast<int64_t>(velocities.size()), 3}));
  const std::vector<float> actual = f.to_host();
  EXPECT_TRUE(same_bits<float>(actual, std::span(&expected[0].x, 3 * expected.size())));
}

// A particle at rest, pressed into the ground so that the spring carries its weight. Returns its
// sliding distance in 200 substeps as a function of its initial velocity.
class Slide : public ::testing::Test {
 protected:
  static constexpr int32_t kSteps = 200;
  static constexpr float kStep = 1e-3f;
  enum class Way { Step, Rollout, Replay };

  Slide() {
    ModelBuilder builder;
    builder.add_particle({0.0f, 0.0f, kRadius - 9.81f / kKe}, {}, 1.0f, kRadius);
    builder.add_ground_plane({.cfg = ShapeConfig{.ke = kKe, .kd = kKd, .kf = kKf, .mu = 1.0f}});
    model = builder.finalize(Device::cpu());
    model->soft_contact_ke = kKe;
    model->soft_contact_kd = kKd;
    model->soft_contact_kf = kKf;
    model->soft_contact_mu = 1.0f;
  }

  diff::DiffSemiImplicitSolver solver_of(bool fixed_contacts) {
    return diff::DiffSemiImplicitSolver(model, {.enable_static_contacts = fixed_contacts});
  }

  // Position and gradient of x at the end.
  std::vector<float> run(bool static_contacts, Way way, float vx = 0.0f) {
    diff::DiffSemiImplicitSolver solver = solver_of(static_contacts);
    CollisionPipeline pipeline(model);
    Contacts found = pipeline.contacts();
    std::vector<SimState> states;
    for (int32_t t = 0; t <= kSteps; ++t) states.push_back(model->state());
    pipeline.collide(states[0], found);
    const Contacts* contacts = static_contacts ? nullptr : &found;
    diff::Trajectory trajectory(model, kSteps);
    SimState& first = way == Way::Step ? states[0] : trajectory.state(0);
    const SimState& last = way == Way::Step ? states[kSteps] : trajectory.state(kSteps);
    const Tensor v = diff::state_particle_qd_tensor(first, true);
    const float start[] = {vx, 0.0f, 0.0f};
    v.copy_from_host(start, sizeof(start));
    const auto forward_and_backward = [&] {
      nova::Tape tape;
      const nova::TapeScope scope(tape);
      if (way == Way::Step) {
        for (size_t t = 0; t < kSteps; ++t)
          solver.step(states[t], states[t + 1], nullptr, contacts, kStep);
      } else {
        solver.rollout(trajectory, nullptr, contacts, kStep);
      }
      const float x[] = {1.0f, 0.0f, 0.0f};
      tape.backward(diff::state_particle_q_tensor(last), Tensor::from_host(std::span(x), {1, 3}));
    };
    if (way == Way::Replay) {
      nova::ScopedCapture capture;
      forward_and_backward();
      capture.end();
      capture.graph()->launch();
    } else {
      forward_and_backward();
    }
    return {last.particle_q.to_host()[0].x, v.grad().to_host()[0]};
  }

  std::shared_ptr<Model> model;
};

TEST_F(Slide, FromRestHasTheGradientOfDifferencesOnEveryPath) {
  for (const bool static_contacts : {true, false}) {
    const std::vector<float> step = run(static_contacts, Way::Step);
    EXPECT_EQ(step[0], 0.0f);
    EXPECT_NEAR(step[1], 0.0857361f, 1e-6f);
    for (const float eps : {1e-1f, 1e-2f, 1e-3f}) {
      const float up = run(static_contacts, Way::Step, eps)[0];
      EXPECT_NEAR(up / eps, step[1], 1e-4f) << eps;
      EXPECT_EQ(up, -run(static_contacts, Way::Step, -eps)[0]);
    }
    for (const Way way : {Way::Rollout, Way::Replay})
      EXPECT_TRUE(same_bits<float>(run(static_contacts, way), step));
  }
}

// Many particles at rest between two shapes, so that every sum of the gradient has several terms.
std::vector<float> corner_gradient(bool rollout, bool static_contacts, bool read_midway) {
  constexpr int32_t kSteps = 12, kParticles = 3000;
  constexpr float kStep = 1e-3f;
  ModelBuilder builder;
  for (int32_t k = 0; k < kParticles; ++k) {
    const float x = 0.09f + 1e-5f * static_cast<float>(k % 97);
    const float v = k % 3 == 0 ? 0.0f : 0.3f * std::sin(static_cast<float>(k));
    builder.add_particle({x, 0.07f * std::cos(static_cast<float>(k)), 0.085f}, {v, -v, 0.5f * v},
                         1.0f, kRadius);
  }
  const ShapeConfig cfg{.ke = kKe, .kd = kKd, .kf = kKf, .mu = kMu};
  builder.add_ground_plane({.cfg = cfg});
  Transformf wall;
  wall.p = {-0.5f, 0.0f, 0.0f};
  builder.add_shape_box(-1, {.xform = wall, .hx = 0.5f, .hy = 1.0f, .hz = 1.0f, .cfg = cfg});
  const auto model = builder.finalize(Device::cpu());
  diff::DiffSemiImplicitSolver solver(model, {.enable_static_contacts = static_contacts});
  CollisionPipeline pipeline(model);
  Contacts found = pipeline.contacts();
  std::vector<SimState> states;
  for (int32_t t = 0; t <= kSteps; ++t) states.push_back(model->state());
  pipeline.collide(states[0], found);
  const Contacts* contacts = static_contacts ? nullptr : &found;
  diff::Trajectory trajectory(model, kSteps);
  const auto state = [&](int32_t t) -> SimState& {
    return rollout ? trajectory.state(t) : states[static_cast<size_t>(t)];
  };
  const Tensor leaves[] = {diff::state_particle_q_tensor(state(0), true),
                           diff::state_particle_qd_tensor(state(0), true)};
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  if (rollout) {
    solver.rollout(trajectory, nullptr, contacts, kStep);
  } else {
    for (int32_t t = 0; t < kSteps; ++t)
      solver.step(state(t), state(t + 1), nullptr, contacts, kStep);
  }
  const Tensor q = diff::state_particle_q_tensor(state(kSteps)),
               qd = diff::state_particle_qd_tensor(state(kSteps));
  Tensor loss = nova::add(nova::dot(q, q), nova::dot(qd, qd));
  if (read_midway) {
    const Tensor v = diff::state_particle_qd_tensor(state(kSteps / 2));
    loss = nova::add(loss, nova::dot(v, v));
  }
  tape.backward(loss);
  std::vector<float> all;
  for (const Tensor& leaf : leaves) {
    const std::vector<float> g = leaf.grad().to_host();
    all.insert(all.end(), g.begin(), g.end());
  }
  return all;
}

TEST(TwoContactsAtOnce, StepAndRolloutHaveOneGradient) {
  for (const bool static_contacts : {true, false}) {
    for (const bool midway : {true, false}) {
      const std::vector<float> step = corner_gradient(false, static_contacts, midway);
      EXPECT_TRUE(same_bits<float>(corner_gradient(true, static_contacts, midway), step))
          << static_contacts << midway;
    }
  }
}

TEST(TwoContactsAtOnce, ThreadsChangeNoBit) {
  const Threads first(1);
  const std::vector<float> one = corner_gradient(true, true, true);
  for (const int count : {2, 7}) {
    const Threads threads(count);
    EXPECT_TRUE(same_bits<float>(corner_gradient(true, true, true), one)) << count;
  }
}

TEST(StaticContacts, AParticleThatIsNowhereIsNotTakenForAFreeOne) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const float radius : {0.0f, kRadius}) {
    ModelBuilder builder;
    builder.add_particle({0.0f, 0.0f, 0.0f}, {}, 1.0f, radius);
    builder.add_shape_box(-1);
    builder.add_shape_sphere(-1);
    builder.add_ground_plane();
    const auto model = builder.finalize(Device::cpu());
    for (const Vec3f& x : {Vec3f{nan, 0, 0}, Vec3f{0, nan, 0}, Vec3f{0, 0, nan}}) {
      model->particle_q.fill(x);
      const Tensor f = diff::eval_static_particle_shape_contact_forces_generated(
          *model, Tensor::view(model->particle_q), Tensor::view(model->particle_qd),
          Tensor({1, 3}));
      for (const float component : f.to_host()) EXPECT_TRUE(std::isnan(component));
    }
  }
}

}  // namespace
}  // namespace novaphy::testing
