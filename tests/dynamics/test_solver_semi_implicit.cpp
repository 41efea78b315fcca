#include <gtest/gtest.h>

#include <cfenv>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

// Steps with fresh contacts; returns the last state.
SimState simulate(const std::shared_ptr<Model>& model, int steps, float dt, float gap = 0.1f) {
  CollisionPipeline pipeline(model, {.soft_contact_margin = gap});
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  for (int i = 0; i < steps; ++i) {
    a.clear_forces();
    pipeline.collide(a, contacts);
    solver.step(a, b, nullptr, &contacts, dt);
    std::swap(a, b);
  }
  return a;
}

std::shared_ptr<Model> one_particle(const Vec3f& q = {}, const Vec3f& qd = {}) {
  ModelBuilder builder;
  builder.add_particle(q, qd, 2.0f);
  builder.add_ground_plane();
  return builder.finalize(Device::cpu());
}

// Marks the solver as used, as a call in another thread would.
class BusySolver : public SolverSemiImplicit {
 public:
  using SolverBase::use;
  using SolverSemiImplicit::SolverSemiImplicit;
};

TEST(SolverSemiImplicit, ASecondCallAtTheSameTimeIsRefusedAndWritesNothing) {
  const auto model = one_particle({0.0f, 0.0f, 1.0f});
  BusySolver solver(model);
  SimState a = model->state(), b = model->state();
  const uint64_t version = b.particle_q.version();
  {
    const ExclusiveUse::Scope other = solver.use("step");
    try {
      solver.step(a, b, nullptr, nullptr, 0.01f);
      FAIL();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Runtime);
      EXPECT_STREQ(error.what(),
                   "SolverSemiImplicit.step: the solver is in use by another call; give every "
                   "thread one of its own");
    }
    EXPECT_THROW(solver.notify_model_changed({}), Error);
  }
  EXPECT_EQ(b.particle_q.version(), version);
  EXPECT_NO_THROW(solver.step(a, b, nullptr, nullptr, 0.01f));
}

// Symplectic Euler from rest: v = g*n*dt, x = g*dt^2*n*(n + 1)/2.
TEST(SolverSemiImplicit, FreeFallIsSymplecticEuler) {
  const auto model = one_particle({1.0f, 2.0f, 100.0f});
  constexpr int kSteps = 480;
  constexpr double kDt = 1.0 / 480.0;
  const SimState end = simulate(model, kSteps, static_cast<float>(kDt));
  const Vec3f q = end.particle_q.to_host()[0], qd = end.particle_qd.to_host()[0];
  EXPECT_EQ(q.x, 1.0f);
  EXPECT_EQ(q.y, 2.0f);
  EXPECT_NEAR(qd.z, -9.81 * kSteps * kDt, 1e-4);
  EXPECT_NEAR(q.z, 100.0 - 9.81 * kDt * kDt * kSteps * (kSteps + 1) / 2.0, 1e-3);
}

// At rest the spring carries the weight: depth = m*g/ke.
TEST(SolverSemiImplicit, ARestingParticleSinksByItsWeightOverTheStiffness) {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 0.1f}, {}, 2.0f);
  builder.add_ground_plane({.cfg = ShapeConfig{.ke = 1e4f, .kd = 200.0f, .kf = 0.0f}});
  const auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 1e4f;
  model->soft_contact_kd = 200.0f;
  const SimState end = simulate(model, 8000, 1e-3f);
  EXPECT_NEAR(end.particle_q.to_host()[0].z, 0.1 - 2.0 * 9.81 / 1e4, 1e-5);
  EXPECT_NEAR(end.particle_qd.to_host()[0].z, 0.0, 1e-4);
}

// On a slope steeper than the friction angle a particle slides with a = g*(sin(s) - mu*cos(s)).
TEST(SolverSemiImplicit, SlidesDownASlopeWithCoulombFriction) {
  const double slope = std::numbers::pi / 6.0;
  const auto nx = static_cast<float>(std::sin(slope)), nz = static_cast<float>(std::cos(slope));
  const float mu = 0.3f, depth = 9.81f * nz / 1e4f;
  ModelBuilder builder;
  builder.add_particle(Vec3f{nx, 0.0f, nz} * (0.1f - depth), {}, 1.0f);
  builder.add_shape_plane({.plane = {nx, 0.0f, nz, 0.0f},
                           .width = 0.0f,
                           .length = 0.0f,
                           .cfg = ShapeConfig{.ke = 1e4f, .kd = 100.0f, .kf = 1e5f, .mu = mu}});
  const auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 1e4f;
  model->soft_contact_kd = 100.0f;
  model->soft_contact_kf = 1e5f;
  model->soft_contact_mu = mu;
  const float dt = 1e-4f;
  const SimState end = simulate(model, 10000, dt);
  const Vec3f v = end.particle_qd.to_host()[0];
  const double along = v.x * std::cos(slope) - v.z * std::sin(slope);
  const double expected = 9.81 * (std::sin(slope) - mu * std::cos(slope)) * 1.0;
  EXPECT_NEAR(along, expected, 0.01 * expected);
}

// Below the friction angle the body creeps at v = m*g*sin(s)/kf, by the viscous branch.
TEST(SolverSemiImplicit, CreepsOnAFlatSlope) {
  const double slope = 0.1;
  const auto nx = static_cast<float>(std::sin(slope)), nz = static_cast<float>(std::cos(slope));
  ModelBuilder builder;
  builder.add_particle(Vec3f{nx, 0.0f, nz} * (0.1f - 9.81f * nz / 1e4f), {}, 1.0f);
  builder.add_shape_plane({.plane = {nx, 0.0f, nz, 0.0f},
                           .width = 0.0f,
                           .length = 0.0f,
                           .cfg = ShapeConfig{.ke = 1e4f, .kd = 100.0f, .kf = 100.0f, .mu = 1.0f}});
  const auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 1e4f;
  model->soft_contact_kd = 100.0f;
  model->soft_contact_kf = 100.0f;
  model->soft_contact_mu = 1.0f;
  const SimState end = simulate(model, 10000, 1e-4f);
  const Vec3f v = end.particle_qd.to_host()[0];
  EXPECT_NEAR(v.x * std::cos(slope) - v.z * std::sin(slope), 9.81 * std::sin(slope) / 100.0, 1e-4);
}

// Without damping and friction a bounce keeps the energy, up to the error of the step.
TEST(SolverSemiImplicit, AnUndampedBounceKeepsTheEnergy) {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 1.0f}, {}, 1.0f);
  builder.add_ground_plane({.cfg = ShapeConfig{.ke = 1e3f, .kd = 0.0f, .kf = 0.0f}});
  const auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 1e3f;
  model->soft_contact_kd = 0.0f;
  model->soft_contact_kf = 0.0f;
  const SimState end = simulate(model, 20000, 1e-4f);  // 2 s: down, up, down
  const Vec3f q = end.particle_q.to_host()[0], qd = end.particle_qd.to_host()[0];
  const double c = std::min(0.0f, q.z - 0.1f);
  EXPECT_NEAR(0.5 * qd.z * qd.z + 9.81 * q.z + 0.5 * 1e3 * c * c, 9.81, 0.02);
}

TEST(SolverSemiImplicit, AddsToTheForcesThatAreThere) {
  const auto model = one_particle({0.0f, 0.0f, 0.05f});
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  pipeline.collide(a, contacts);
  solver.step(a, b, nullptr, &contacts, 0.01f);
  const Vec3f contact = a.particle_f.to_host()[0];
  EXPECT_NEAR(contact.z, 0.05f * 0.5f * (1e3f + 2500.0f), 1e-3);
  a.particle_f.fill({1.0f, 2.0f, 3.0f});
  solver.step(a, b, nullptr, &contacts, 0.01f);
  EXPECT_EQ(a.particle_f.to_host()[0].x, 1.0f);
  EXPECT_NEAR(a.particle_f.to_host()[0].z, contact.z + 3.0f, 1e-4);
  EXPECT_NEAR(b.particle_qd.to_host()[0].x, 0.5f * 0.01f, 1e-7);

  a.clear_forces();
  solver.step(a, b, nullptr, nullptr, 0.01f);
  EXPECT_EQ(a.particle_f.to_host()[0], (Vec3f{}));
}

TEST(SolverSemiImplicit, NoticesContactsThatWereWrittenAnew) {
  const auto model = one_particle({0.0f, 0.0f, 0.05f});
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  const auto force = [&] {
    a.clear_forces();
    solver.step(a, b, nullptr, &contacts, 0.01f);
    return a.particle_f.to_host()[0].z;
  };
  EXPECT_EQ(force(), 0.0f);
  pipeline.collide(a, contacts);
  EXPECT_GT(force(), 1.0f);
  contacts.clear();
  EXPECT_EQ(force(), 0.0f);
  pipeline.collide(a, contacts);
  contacts.soft_contact_count.fill(0);
  EXPECT_EQ(force(), 0.0f);

  // A writable export may change the bytes without raising a version.
  contacts.soft_contact_count.range()->mark_writable_export();
  EXPECT_EQ(force(), 0.0f);
  const_cast<int32_t*>(contacts.soft_contact_count.data())[0] = 1;
  EXPECT_GT(force(), 1.0f);
}

TEST(SolverSemiImplicit, UsesTheContactsThatHaveASlot) {
  ModelBuilder builder;
  for (int i = 0; i < 4; ++i) builder.add_particle({static_cast<float>(i), 0.0f, 0.05f}, {}, 1.0f);
  builder.add_ground_plane();
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model, {.soft_contact_max = 2});
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  pipeline.collide(a, contacts);
  solver.step(a, b, nullptr, &contacts, 0.01f);
  const auto f = a.particle_f.to_host();
  EXPECT_TRUE(contacts.overflowed());
  EXPECT_GT(f[1].z, 1.0f);
  EXPECT_EQ(f[2].z, 0.0f);
}

TEST(SolverSemiImplicit, GivesTheSameBitsForAnyNumberOfThreads) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  ModelBuilder builder;
  for (int i = 0; i < 3000; ++i) {
    builder.add_particle({uniform(random), uniform(random), uniform(random)},
                         {uniform(random), uniform(random), uniform(random)},
                         1.0f + uniform(random));
  }
  builder.add_ground_plane();
  builder.add_shape_box(-1, {.hz = 0.2f});
  builder.add_shape_sphere(-1, {.xform = {{0.5f, 0.5f, 0.5f}, Quatf::identity()}, .radius = 0.7f});
  const auto model = builder.finalize(Device::cpu());
  const int before = num_threads();
  set_num_threads(1);
  const auto expected = simulate(model, 20, 1e-3f).particle_q.to_host();
  for (const int threads : {2, 7}) {
    set_num_threads(threads);
    const auto q = simulate(model, 20, 1e-3f).particle_q.to_host();
    EXPECT_TRUE(testing::same_bits(std::span<const Vec3f>(q), std::span<const Vec3f>(expected)))
        << threads;
  }
  set_num_threads(before);
}

// A library in the same process may have left the thread in another rounding mode.
TEST(SolverSemiImplicit, GivesTheSameBitsInAnyRoundingMode) {
  ModelBuilder builder;
  builder.add_particle({0.1f, 0.2f, 0.05f}, {0.3f, 0.4f, -0.7f}, 1.3f);
  builder.add_shape_plane(
      {.plane = {0.1f, 0.3f, 0.9f, 0.01f}, .cfg = ShapeConfig{.margin = 0.03f}});
  const auto model = builder.finalize(Device::cpu());
  const auto expected = simulate(model, 20, 1e-3f).particle_q.to_host();
  const int before = std::fegetround();
  std::fesetround(FE_UPWARD);
  const auto q = simulate(model, 20, 1e-3f).particle_q.to_host();
  EXPECT_EQ(std::fegetround(), FE_UPWARD);
  std::fesetround(before);
  EXPECT_TRUE(testing::same_bits(std::span<const Vec3f>(q), std::span<const Vec3f>(expected)));
}

TEST(SolverSemiImplicit, ReadsTheGravityOfTheParticlesWorld) {
  const auto model = one_particle({0.0f, 0.0f, 5.0f});
  model->set_gravity({1.0f, 0.0f, 0.0f});
  for (const int32_t world : {-1, 0}) {
    model->particle_world.fill(world);
    SolverSemiImplicit solver(model);
    SimState a = model->state(), b = model->state();
    solver.step(a, b, nullptr, nullptr, 0.5f);
    EXPECT_EQ(b.particle_qd.to_host()[0], (Vec3f{0.5f, 0.0f, 0.0f}));
  }
  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  model->particle_world.fill(1);
  EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, 0.5f), ErrorKind::Index,
               "particle_world[0]: expected -1 to 0, got 1");
}

TEST(SolverSemiImplicit, StepsAModelOfNothing) {
  const auto model = ModelBuilder().finalize(Device::cpu());
  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  EXPECT_NO_THROW(solver.step(a, b, nullptr, nullptr, 0.01f));
  EXPECT_FALSE(solver.supports_graph_capture());
}

TEST(SolverSemiImplicit, RefusesBadInput) {
  const auto model = one_particle(), other = one_particle();
  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  EXPECT_ERROR(SolverSemiImplicit(nullptr), ErrorKind::Value, "model: expected a model, got null");
  EXPECT_ERROR(SolverSemiImplicit(model, {.angular_damping = -1.0f}), ErrorKind::Value,
               "angular_damping");
  EXPECT_ERROR(SolverSemiImplicit(model, {.joint_attach_ke = kNan}), ErrorKind::Value,
               "joint_attach_ke");
  for (const float dt : {0.0f, -0.01f, kNan, kInf}) {
    EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, dt), ErrorKind::Value,
                 "dt: expected a finite number > 0");
  }
  SimState foreign = other->state();
  EXPECT_ERROR(solver.step(foreign, b, nullptr, nullptr, 0.01f), ErrorKind::Value,
               "state_in: expected one of the");
  EXPECT_ERROR(solver.step(a, foreign, nullptr, nullptr, 0.01f), ErrorKind::Value,
               "state_out: expected one of the");
  const Control control = other->control();
  EXPECT_ERROR(solver.step(a, b, &control, nullptr, 0.01f), ErrorKind::Value,
               "control: expected one of the");
  const Contacts contacts = CollisionPipeline(other).contacts();
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Value,
               "contacts: expected one of the");
  SimState alias = model->state();
  alias.particle_q = a.particle_q;
  EXPECT_ERROR(solver.step(a, alias, nullptr, nullptr, 0.01f), ErrorKind::Value,
               "state_out.particle_q: expected memory");
  SimState cut = model->state();
  cut.particle_f = DeviceArray<Vec3f>(2, Device::cpu());
  EXPECT_ERROR(solver.step(cut, b, nullptr, nullptr, 0.01f), ErrorKind::Value,
               "state_in.particle_f: expected 1 rows");
  model->soft_contact_ke = kNan;
  EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, 0.01f), ErrorKind::Value,
               "model.soft_contact_ke");
}

TEST(SolverSemiImplicit, RefusesContactsThatItCannotUse) {
  const auto model = one_particle({0.0f, 0.0f, 0.05f});
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  Contacts contacts = pipeline.contacts();
  pipeline.collide(a, contacts);
  contacts.soft_contact_particle.fill(1);
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Index,
               "soft_contact_particle[0]: expected 0 to 0, got 1");
  contacts.soft_contact_particle.fill(0);
  contacts.soft_contact_shape.fill(-1);
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Index,
               "soft_contact_shape[0]");
  contacts.soft_contact_shape.fill(0);
  model->shape_body.fill(3);
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Index,
               "model.shape_body[0]: expected -1 to -1, got 3");
  model->shape_body.fill(-1);
  EXPECT_NO_THROW(solver.step(a, b, nullptr, &contacts, 0.01f));
  contacts.soft_contact_normal = DeviceArray<Vec3f>(2, Device::cpu());
  EXPECT_ERROR(solver.step(a, b, nullptr, &contacts, 0.01f), ErrorKind::Value,
               "soft_contact_normal: expected 1 rows");
}

// An observer as a tape or a capture installs one.
class Recorder : public ArrayObserver {
 public:
  void host_read(const char*) override {}
  void untracked_write(Range&, const char*) override { ++writes; }
  bool copy(const std::shared_ptr<Range>&, const std::shared_ptr<Range>&, bool) override {
    return false;
  }
  void untracked_operation(const char* what) override {
    fail(ErrorKind::Runtime, what, " cannot be recorded");
  }
  int writes = 0;
};

TEST(SolverSemiImplicit, TellsTheObserverBeforeItDoesAnything) {
  const auto model = one_particle();
  SolverSemiImplicit solver(model);
  SimState a = model->state(), b = model->state();
  Recorder recorder;
  ArrayObserver* before = set_array_observer(&recorder);
  EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, 0.01f), ErrorKind::Runtime,
               "SolverSemiImplicit.step cannot be");
  EXPECT_EQ(recorder.writes, 0);
  set_array_observer(before);
}

}  // namespace
}  // namespace novaphy
