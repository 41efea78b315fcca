// Rigid bodies of SolverSemiImplicit: closed forms, friction laws, worlds, threads, bad input.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/sim/trajectory.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/threads.h"

namespace novaphy {
namespace {

constexpr float kDt = 1.0f / 960.0f, kGravity = 9.81f;
constexpr Vec3f kNone{0.0f, 0.0f, 0.0f};

Mat33f diagonal(float x, float y, float z) {
  return {{{x, 0.0f, 0.0f}, {0.0f, y, 0.0f}, {0.0f, 0.0f, z}}};
}

struct Body {
  Transformf q;
  SpatialVectorf qd;
};

// Steps a model with its contacts; `each` sees the state after every step.
struct Simulation {
  explicit Simulation(std::shared_ptr<Model> of, const SemiImplicitOptions& options = {})
      : model(std::move(of)), pipeline(model), solver(model, options) {}
  void steps(int count, float dt = kDt, const std::function<void(int)>& each = {}) {
    for (int t = 0; t < count; ++t) {
      pipeline.collide(now, contacts);
      solver.step(now, next, nullptr, &contacts, dt);
      std::swap(now, next);
      if (each) each(t);
    }
  }
  Body body(size_t b = 0) const { return {now.body_q.to_host()[b], now.body_qd.to_host()[b]}; }

  std::shared_ptr<Model> model;
  CollisionPipeline pipeline;
  SolverSemiImplicit solver;
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
};

constexpr ShapeConfig kSurface = {.ke = 1.0e4f, .kd = 300.0f, .kf = 500.0f, .mu = 0.5f};

ModelBuilder box_on_plane(float height, const ShapeConfig& cfg = kSurface) {
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = cfg});
  builder.add_body({.xform = {{0.0f, 0.0f, height}, Quatf::identity()}, .mass = 4.0f});
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = cfg});
  return builder;
}

TEST(RigidBodies, FallFreelyByTheSumsOfSymplecticEuler) {
  ModelBuilder builder;
  builder.add_body({.mass = 2.0f, .inertia = diagonal(1.0f, 1.0f, 1.0f)});
  builder.body_qd[0].linear = {3.0f, 0.0f, 4.0f};
  Simulation run(builder.finalize(Device::cpu()));
  const int n = 480;
  run.steps(n);
  const Body body = run.body();
  EXPECT_NEAR(body.q.p.x, 3.0 * n * kDt, 1e-4);
  // z = sum over k of (v - g k dt) dt
  EXPECT_NEAR(body.q.p.z, 4.0 * n * kDt - 0.5 * kGravity * kDt * kDt * n * (n + 1.0), 1e-4);
  EXPECT_NEAR(body.qd.linear.z, 4.0 - kGravity * n * kDt, 1e-4);
}

TEST(RigidBodies, AForceAndAMomentActAtTheCenterOfMassAndStayInTheState) {
  ModelBuilder builder(Axis::Z, kNone);
  builder.add_body(
      {.com = {0.5f, 0.0f, 0.0f}, .mass = 2.0f, .inertia = diagonal(1.0f, 2.0f, 2.5f)});
  Simulation run(builder.finalize(Device::cpu()), {.angular_damping = 0.0f});
  const SpatialVectorf wrench = {{2.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 5.0f}};
  run.now.body_f.fill(wrench);
  run.next.body_f.fill(wrench);
  run.steps(96);
  EXPECT_EQ(run.now.body_f.to_host()[0], wrench);
  const Body body = run.body();
  EXPECT_NEAR(body.qd.linear.x, 0.1f, 1e-5f);   // 2 N / 2 kg * 0.1 s
  EXPECT_NEAR(body.qd.angular.z, 0.2f, 1e-5f);  // 5 Nm / 2.5 kg m^2 * 0.1 s
  // The center of mass moves on a line, and the origin rotates about it.
  const Vec3f center = math::transform_point(body.q, Vec3f{0.5f, 0.0f, 0.0f});
  EXPECT_NEAR(center.y, 0.0f, 1e-6f);
  EXPECT_NEAR(center.x, 0.5f + 0.5f * 0.1f * 0.1f, 1e-4f);
}

// Torque-free precession of a symmetric top: in the body frame w turns about z with
// (I_z - I_x)/I_x w_z.
TEST(RigidBodies, ASymmetricTopPrecesses) {
  ModelBuilder builder(Axis::Z, kNone);
  builder.add_body({.mass = 1.0f, .inertia = diagonal(1.0f, 1.0f, 1.5f)});
  builder.body_qd[0].angular = {0.5f, 0.0f, 4.0f};
  Simulation run(builder.finalize(Device::cpu()), {.angular_damping = 0.0f});
  const double rate = 0.5 * 4.0;
  run.steps(960);
  const Body body = run.body();
  const Vec3f w = math::rotate_inverse(body.q.q, body.qd.angular);
  EXPECT_NEAR(std::atan2(w.y, w.x), rate * 1.0, 3e-3);
  EXPECT_NEAR(std::hypot(w.x, w.y), 0.5, 0.5 * 3e-3);  // the explicit gyroscopic term gains energy
  EXPECT_NEAR(w.z, 4.0, 4.0 * 3e-4);
  // The angular momentum keeps its direction.
  const Vec3f l = math::rotate(body.q.q, Vec3f{w.x, w.y, 1.5f * w.z});
  EXPECT_NEAR(l.x / l.z, 0.5 / 6.0, 1e-3);
  EXPECT_NEAR(l.y, 0.0, 1e-2);
}

TEST(RigidBodies, ABoxRestsAtItsWeightOverTheStiffness) {
  Simulation run(box_on_plane(0.1f).finalize(Device::cpu()));
  run.steps(3000);
  // m g / (4 ke), 12 kg
  EXPECT_NEAR(run.body().q.p.z, 0.1 - 12.0 * kGravity / (4 * 1.0e4), 2e-6);
  EXPECT_EQ(run.contacts.active_rigid_contact_count(), 4);
  // The forces of the contacts carry the weight.
  float lift = 0.0f;
  for (const RigidContact& contact : run.contacts.rigid_contacts()) lift += contact.force.z;
  EXPECT_NEAR(lift, 12.0f * kGravity, 0.05f);
}

TEST(RigidBodies, TheMarginOfTheWorldAndOfTheBodyMovesTheSurface) {
  ShapeConfig wide = kSurface;
  wide.margin = 0.02f;
  Simulation run(box_on_plane(0.15f, wide).finalize(Device::cpu()));
  run.steps(3000);
  EXPECT_NEAR(run.body().q.p.z, 0.1 + 0.04 - 12.0 * kGravity / (4 * 1.0e4), 2e-6);
}

// The plane through the origin that falls along x by an angle.
Transformf slope(double angle) {
  return {{},
          {0.0f, static_cast<float>(std::sin(angle / 2)), 0.0f,
           static_cast<float>(std::cos(angle / 2))}};
}
ModelBuilder body_on_slope(double angle, const ShapeConfig& cfg, float above) {
  ModelBuilder builder;
  builder.add_shape_plane({.xform = slope(angle), .width = 0.0f, .length = 0.0f, .cfg = cfg});
  const Quatf q = slope(angle).q;
  builder.add_body({.xform = {math::rotate(q, Vec3f{0.0f, 0.0f, above}), q}});
  return builder;
}
double along_slope(const Vec3f& v, double angle) {
  return v.x * std::cos(angle) - v.z * std::sin(angle);
}

TEST(RigidBodies, ASphereRollsAtFiveSeventhsOfTheSlope) {
  const double angle = 0.2;
  ModelBuilder builder = body_on_slope(angle, kSurface, 0.1f);
  builder.add_shape_sphere(0, {.radius = 0.1f, .cfg = kSurface});
  Simulation run(builder.finalize(Device::cpu()), {.angular_damping = 0.0f});
  run.steps(480);
  const double before = along_slope(run.body().qd.linear, angle);
  run.steps(480);
  const Body body = run.body();
  EXPECT_NEAR(along_slope(body.qd.linear, angle) - before,
              5.0 / 7.0 * kGravity * std::sin(angle) * 0.5, 5e-3);
  EXPECT_NEAR(body.qd.angular.y * 0.1f, along_slope(body.qd.linear, angle), 1e-2);
  EXPECT_EQ(body.q.p.y, 0.0f);
}

// Below the cone a contact creeps: viscous with load/(4 kf), huber with
// max(rho c/kf, e (1 - sqrt(1 - rho^2))/rho), rho the load over the cone.
TEST(RigidBodies, ABoxOnASlopeCreepsAsItsLawSays) {
  const double angle = 0.3, mu = 0.5, mass = 8.0;
  const double load = mass * kGravity * std::sin(angle);
  const double cone = mu * mass * kGravity * std::cos(angle), rho = load / cone;
  const auto creep = [&](const SemiImplicitOptions& options) {
    ModelBuilder builder = body_on_slope(angle, kSurface, 0.1f);
    builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
    Simulation run(builder.finalize(Device::cpu()), options);
    run.steps(2000);
    return along_slope(run.body().qd.linear, angle);
  };
  EXPECT_NEAR(creep({}), load / (4 * 500.0), 0.01 * load / (4 * 500.0));
  for (const float e : {0.01f, 0.1f, 0.3f}) {
    const double smooth = e * (1.0 - std::sqrt(1.0 - rho * rho)) / rho;
    const double expected = std::max(load / (4 * 500.0), smooth);
    EXPECT_NEAR(creep({.friction_law = FrictionLaw::Huber, .friction_smoothing = e}), expected,
                0.01 * expected)
        << e;
  }
}

TEST(RigidBodies, ABoxAboveTheFrictionAngleSlides) {
  const double angle = 0.7, mu = 0.5;
  ModelBuilder builder = body_on_slope(angle, kSurface, 0.1f);
  // The body is flat, so that it does not topple.
  builder.add_shape_box(0, {.hx = 0.3f, .hy = 0.3f, .hz = 0.02f, .cfg = kSurface});
  builder.body_q[0].p = math::rotate(builder.body_q[0].q, Vec3f{0.0f, 0.0f, 0.02f});
  Simulation run(builder.finalize(Device::cpu()));
  run.steps(480);
  const double before = along_slope(run.body().qd.linear, angle);
  run.steps(480);
  const double expected = kGravity * (std::sin(angle) - mu * std::cos(angle)) * 0.5;
  EXPECT_NEAR(along_slope(run.body().qd.linear, angle) - before, expected, 0.01 * expected);
}

TEST(RigidFriction, StaysInTheConeButForNewtons17) {
  for (const FrictionLaw law : {FrictionLaw::Viscous, FrictionLaw::Huber})
    for (const float e : {0.0f, 0.01f, 0.1f, 1.0f})
      for (float s = 1e-4f; s < 10.0f; s *= 1.3f)
        for (const float limit : {0.0f, 0.18f, 50.0f}) {
          const Vec3f f = rigid_friction(law, Vec3f{0.6f * s, 0.8f * s, 0.0f}, limit, 1e3f, e);
          EXPECT_LE(math::length(f), limit * (1.0f + 1e-6f)) << s;
        }
  const Vec3f f = rigid_friction(FrictionLaw::Newton17, Vec3f{0.1f, 0.0f, 0.0f}, 0.18f, 1e3f, 1.0f);
  EXPECT_NEAR(math::length(f) / 0.18f, 20.0f, 0.01f);
}

TEST(RigidFriction, HuberIsSmoothAndTendsToViscous) {
  const auto huber = [](float s, float e) {
    return rigid_friction(FrictionLaw::Huber, Vec3f{s, 0.0f, 0.0f}, 0.18f, 1e3f, e).x / 0.18f;
  };
  EXPECT_NEAR(huber(0.02f, 0.1f), 0.385f, 1e-3f);
  EXPECT_NEAR(huber(0.1f, 1.0f), 0.198f, 1e-3f);
  EXPECT_EQ(huber(0.0f, 0.1f), 0.0f);
  // At s = e value and slope agree.
  const float h = 1e-3f;
  EXPECT_NEAR(huber(0.1f - 1e-6f, 0.1f), huber(0.1f + 1e-6f, 0.1f), 1e-4f);
  EXPECT_NEAR((huber(0.1f, 0.1f) - huber(0.1f - h, 0.1f)) / h, 0.0f, 0.1f);
  for (const float s : {0.0f, 1e-5f, 1e-3f, 1.0f})
    EXPECT_EQ(
        huber(s, 0.0f),
        rigid_friction(FrictionLaw::Viscous, Vec3f{s, 0.0f, 0.0f}, 0.18f, 1e3f, 0.0f).x / 0.18f);
}

TEST(RigidBodies, AKinematicBodyFollowsItsVelocity) {
  ModelBuilder builder;
  builder.add_body({.com = {0.0f, 1.0f, 0.0f}, .is_kinematic = true});
  builder.body_qd[0] = {{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 1.0f}};
  Simulation run(builder.finalize(Device::cpu()));
  run.now.body_f.fill({{100.0f, 0.0f, 0.0f}, {}});
  run.steps(960);
  const Body body = run.body();
  EXPECT_EQ(body.qd, (SpatialVectorf{{}, {0.0f, 0.0f, 1.0f}}));
  EXPECT_NEAR(body.q.q.z, std::sin(0.5), 1e-5);
  EXPECT_NEAR(body.q.p.x, std::sin(1.0), 1e-4);  // the origin turns about the center of mass
}

TEST(RigidBodies, TwoWorldsInOnePlaceEqualOneAlone) {
  ModelBuilder one = box_on_plane(0.12f);
  one.body_qd[0] = {{1.0f, 0.3f, 0.0f}, {1.0f, 5.0f, 2.0f}};
  ModelBuilder both;
  both.add_world(one);
  both.add_world(one);
  Simulation alone(one.finalize(Device::cpu())), worlds(both.finalize(Device::cpu()));
  alone.steps(480);
  worlds.steps(480);
  const auto q = alone.now.body_q.to_host();
  for (size_t w = 0; w < 2; ++w) {
    const auto of_world = worlds.now.body_q.to_host();
    EXPECT_TRUE(testing::same_bits(std::span<const Transformf>(of_world).subspan(w, 1),
                                   std::span<const Transformf>(q)));
  }
}

TEST(RigidBodies, WorldsHaveTheirOwnGravity) {
  ModelBuilder one;
  one.add_body({.mass = 1.0f, .inertia = diagonal(1.0f, 1.0f, 1.0f)});
  ModelBuilder both;
  both.replicate(one, 2);
  Simulation run(both.finalize(Device::cpu()));
  run.model->set_gravity(kNone, 0);
  run.steps(10);
  EXPECT_EQ(run.body(0).qd.linear.z, 0.0f);
  EXPECT_LT(run.body(1).qd.linear.z, -0.1f);
}

// The force on one body is the opposite of that on the other, at points that agree to the depth.
TEST(RigidBodies, ACollisionKeepsTheMomentum) {
  const ShapeConfig cfg = {.ke = 1e4f, .kd = 10.0f, .kf = 100.0f, .mu = 0.5f};
  ModelBuilder builder(Axis::Z, kNone);
  builder.add_body({.xform = {{-0.6f, 0.0f, 0.0f}, Quatf::identity()}});
  builder.add_shape_box(0, {.hx = 0.3f, .hy = 0.2f, .hz = 0.2f, .cfg = cfg});
  builder.body_qd[0] = {{2.0f, 0.0f, 0.0f}, {0.3f, 0.0f, 1.0f}};
  builder.add_body({.xform = {{0.4f, 0.1f, 0.05f}, Quatf::identity()}});
  builder.add_shape_sphere(1, {.radius = 0.3f, .cfg = cfg});
  Simulation run(builder.finalize(Device::cpu()), {.angular_damping = 0.0f});
  const std::vector<float> mass = run.model->body_mass.to_host();
  const auto momentum = [&] {
    Vec3f sum;
    for (size_t b = 0; b < 2; ++b) sum = sum + run.body(b).qd.linear * mass[b];
    return sum;
  };
  const Vec3f before = momentum();
  float largest = 0.0f;
  run.steps(480, kDt, [&](int) {
    for (const RigidContact& c : run.contacts.rigid_contacts())
      largest = std::max(largest, math::length(c.force));
  });
  EXPECT_GT(largest, 100.0f);
  EXPECT_LT(run.body(0).qd.linear.x, 1.9f);
  EXPECT_NEAR(math::length(momentum() - before), 0.0f, 1e-4f * math::length(before));
}

// Every interface carries the weight above it on four corners.
TEST(RigidBodies, FiveAlignedCubesStand) {
  const ShapeConfig cfg = {.ke = 2e5f, .kd = 300.0f, .kf = 200.0f, .mu = 0.5f};
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = cfg});
  for (int b = 0; b < 5; ++b) {
    builder.add_body(
        {.xform = {{0.0f, 0.0f, 0.1f + 0.2f * static_cast<float>(b)}, Quatf::identity()}});
    builder.add_shape_box(b, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = cfg});
  }
  Simulation run(builder.finalize(Device::cpu()));
  run.steps(1920);
  double depth = 0.0;
  for (size_t b = 0; b < 5; ++b) {
    depth += static_cast<double>(5 - b) * 8.0 * kGravity / (4 * 2e5);
    EXPECT_NEAR(run.body(b).q.p.z, 0.1 + 0.2 * static_cast<double>(b) - depth, 2e-5) << b;
    EXPECT_NEAR(run.body(b).q.p.x, 0.0f, 1e-5f);
  }
}

ModelBuilder many_bodies(int count) {
  ModelBuilder builder;
  builder.add_ground_plane({.cfg = kSurface});
  for (int b = 0; b < count; ++b) {
    const float x = 0.25f * static_cast<float>(b % 30), y = 0.25f * static_cast<float>(b / 30);
    builder.add_body({.xform = {{x, y, 0.15f}, Quatf::identity()}});
    builder.body_qd.back() = {{0.1f * x, 0.0f, 0.0f}, {0.3f * y, 0.2f * x, 1.0f}};
    const ShapeConfig& cfg = kSurface;
    if (b % 3 == 0) builder.add_shape_box(b, {.hx = 0.1f, .hy = 0.12f, .hz = 0.1f, .cfg = cfg});
    if (b % 3 == 1) builder.add_shape_capsule(b, {.radius = 0.1f, .half_height = 0.1f, .cfg = cfg});
    if (b % 3 == 2)
      builder.add_shape_cylinder(b, {.radius = 0.1f, .half_height = 0.1f, .cfg = cfg});
  }
  return builder;
}

TEST(RigidBodies, HaveTheSameBitsOnAnyNumberOfThreads) {
  const auto run_on = [](int threads) {
    const testing::Threads set(threads);
    Simulation run(many_bodies(300).finalize(Device::cpu()));
    run.steps(120);
    return std::pair(run.now.body_q.to_host(), run.contacts.rigid_contacts());
  };
  const auto expected = run_on(1);
  EXPECT_GT(expected.second.size(), 300u);
  for (const int threads : {2, 7}) {
    const auto got = run_on(threads);
    EXPECT_TRUE(testing::same_bits(std::span<const Transformf>(got.first),
                                   std::span<const Transformf>(expected.first)));
    EXPECT_EQ(got.second, expected.second);
  }
}

TEST(RigidBodies, ARolloutIsTheStepsOfALoop) {
  const auto model = [] {
    ModelBuilder builder;
    builder.add_body({.mass = 1.0f, .inertia = diagonal(0.1f, 0.2f, 0.15f)});
    builder.body_qd[0].angular = {1.0f, 2.0f, 3.0f};
    return builder.finalize(Device::cpu());
  }();
  SolverSemiImplicit solver(model);
  SimState now = model->state(), next = model->state();
  for (int t = 0; t < 20; ++t) {
    solver.step(now, next, nullptr, nullptr, kDt);
    std::swap(now, next);
  }
  Trajectory trajectory(model, 20);
  solver.rollout(trajectory, nullptr, nullptr, kDt);
  EXPECT_EQ(trajectory.state(20).body_q.to_host(), now.body_q.to_host());
  EXPECT_EQ(trajectory.state(20).body_qd.to_host(), now.body_qd.to_host());
}

TEST(RigidBodies, BadInputIsRefusedAndNothingIsWritten) {
  const auto model = box_on_plane(0.1f).finalize(Device::cpu());
  EXPECT_ERROR(SolverSemiImplicit(model, {.friction_smoothing = 0.1f}), ErrorKind::Value,
               "friction_smoothing");
  EXPECT_ERROR(
      SolverSemiImplicit(model, {.friction_law = FrictionLaw::Huber, .friction_smoothing = -1.0f}),
      ErrorKind::Value, "friction_smoothing");
  EXPECT_ERROR(SolverSemiImplicit(
                   model, {.friction_law = FrictionLaw::Newton17, .friction_smoothing = 0.0f}),
               ErrorKind::Value, "newton17");
  EXPECT_ERROR(SolverSemiImplicit(model, {.friction_law = static_cast<FrictionLaw>(9)}),
               ErrorKind::Value, "friction_law");
  EXPECT_EQ(
      SolverSemiImplicit(model, {.friction_law = FrictionLaw::Huber}).options().friction_smoothing,
      0.1f);
  Simulation run(model);
  run.pipeline.collide(run.now, run.contacts);
  run.next.body_q.fill({{9.0f, 9.0f, 9.0f}, Quatf::identity()});
  run.contacts.rigid_contact_shape1.fill(7);
  EXPECT_ERROR(run.solver.step(run.now, run.next, nullptr, &run.contacts, kDt), ErrorKind::Index,
               "rigid_contact_shape1[0]");
  run.pipeline.collide(run.now, run.contacts);
  model->body_world.fill(3);
  EXPECT_ERROR(run.solver.step(run.now, run.next, nullptr, &run.contacts, kDt), ErrorKind::Index,
               "body_world[0]");
  EXPECT_EQ(run.next.body_q.to_host()[0].p.x, 9.0f);
}

}  // namespace
}  // namespace novaphy
