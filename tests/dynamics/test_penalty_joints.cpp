// Joints of SolverSemiImplicit: Newton's pendulum, closed forms, conservation, limits, bad input.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/penalty_joint_trace.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;

constexpr float kPi = std::numbers::pi_v<float>;
constexpr float kDt = 1.0f / 960.0f;
const Transformf kOrigin = Transformf::identity();

Mat33f diagonal(float x, float y, float z) {
  return {{{x, 0.0f, 0.0f}, {0.0f, y, 0.0f}, {0.0f, 0.0f, z}}};
}
Quatf about(const Vec3f& axis, float angle) {
  const Vec3f v = axis * std::sin(angle / 2.0f);
  return {v.x, v.y, v.z, std::cos(angle / 2.0f)};
}
Transformf at(float x, float y, float z) { return {{x, y, z}, {0.0f, 0.0f, 0.0f, 1.0f}}; }
BodyArgs body(const Transformf& x, float mass = 1.0f, float inertia = 0.1f) {
  return {.xform = x, .mass = mass, .inertia = diagonal(inertia, inertia, inertia)};
}

// Runs a model for some steps, and calls what(t, state) after every step.
template <class What>
SimState run(const std::shared_ptr<Model>& model, int steps, const SemiImplicitOptions& options,
             What&& what, const Control* control = nullptr) {
  SolverSemiImplicit solver(model, options);
  SimState now = model->state(), next = model->state();
  for (int t = 0; t < steps; ++t) {
    solver.step(now, next, control, nullptr, kDt);
    std::swap(now, next);
    what(t, now);
  }
  return now;
}
SimState run(const std::shared_ptr<Model>& model, int steps, const SemiImplicitOptions& options) {
  return run(model, steps, options, [](int, const SimState&) {});
}

TEST(PenaltyJoints, ThePendulumIsNewtons) {
  const Npz file = golden("newton_rigid_scenes.npz");
  const auto array = [&](const char* name) -> const testing::NpyArray& {
    return file[std::string("pendulum_") + name];
  };
  ModelBuilder b(Axis::Z, array("model_gravity").as<Vec3f>()[0]);
  for (size_t i = 0; i < 2; ++i)
    b.add_link({.com = array("model_body_com").as<Vec3f>()[i],
                .mass = array("model_body_mass").as<float>()[i],
                .inertia = array("model_body_inertia").as<Mat33f>()[i]});
  for (size_t j = 0; j < 2; ++j) {
    const auto number = [&](const char* name) {
      return array((std::string("model_joint_") + name).c_str()).as<float>()[j];
    };
    b.add_joint_revolute(array("model_joint_parent").as<int32_t>()[j],
                         array("model_joint_child").as<int32_t>()[j],
                         {.parent_xform = array("model_joint_X_p").as<Transformf>()[j],
                          .child_xform = array("model_joint_X_c").as<Transformf>()[j],
                          .dof = JointDofConfig{.axis = array("model_joint_axis").as<Vec3f>()[j],
                                                .limit_lower = number("limit_lower"),
                                                .limit_upper = number("limit_upper"),
                                                .limit_ke = number("limit_ke"),
                                                .limit_kd = number("limit_kd"),
                                                .target_q = number("target_q"),
                                                .target_ke = number("target_ke"),
                                                .target_kd = number("target_kd")}});
  }
  const auto model = b.finalize(Device::cpu());
  const auto q = array("body_q").as<Transformf>();
  const auto qd = array("body_qd").as<SpatialVectorf>();
  SolverSemiImplicit solver(model, {.friction_law = FrictionLaw::Newton18,
                                    .joint_attach_ke = array("joint_attach_ke").scalar<float>(),
                                    .joint_attach_kd = array("joint_attach_kd").scalar<float>()});
  const float dt = static_cast<float>(array("dt").scalar<double>());
  SimState now = model->state(), next = model->state();
  const auto apart = [](const Transformf& a, const Transformf& b2) {
    return std::max({math::length(a.p - b2.p), std::abs(a.q.x - b2.q.x), std::abs(a.q.y - b2.q.y),
                     std::abs(a.q.z - b2.q.z), std::abs(a.q.w - b2.q.w)});
  };
  // First one step from each of Newton's states, then all steps from the first state.
  float one = 0.0f, all = 0.0f;
  for (size_t t = 0; t < 480; ++t) {
    now.body_q.copy_from_host(q.subspan(2 * t, 2));
    now.body_qd.copy_from_host(qd.subspan(2 * t, 2));
    solver.step(now, next, nullptr, nullptr, dt);
    for (size_t i = 0; i < 2; ++i)
      one = std::max(one, apart(next.body_q.to_host()[i], q[2 * t + 2 + i]));
  }
  now.body_q.copy_from_host(q.subspan(0, 2));
  now.body_qd.copy_from_host(qd.subspan(0, 2));
  for (size_t t = 0; t < 480; ++t) {
    solver.step(now, next, nullptr, nullptr, dt);
    for (size_t i = 0; i < 2; ++i)
      all = std::max(all, apart(next.body_q.to_host()[i], q[2 * t + 2 + i]));
    std::swap(now, next);
  }
  EXPECT_LT(one, 3e-7f);
  EXPECT_LT(all, 1e-6f);
}

// A rod that swings about a hinge: T = 2 pi sqrt((I + m l^2) / (m g l)) for small angles.
TEST(PenaltyJoints, APendulumHasThePeriodOfTheClosedForm) {
  constexpr float kMass = 2.0f, kLength = 0.5f, kInertia = 0.2f, kAngle = 0.05f;
  ModelBuilder b;
  b.add_link({.xform = {{0.0f, 0.0f, 0.0f}, about({0.0f, 1.0f, 0.0f}, kAngle)},
              .com = {0.0f, 0.0f, -kLength},
              .mass = kMass,
              .inertia = diagonal(kInertia, kInertia, kInertia)});
  b.add_joint_revolute(-1, 0, {.dof = JointDofConfig{.axis = {0.0f, 1.0f, 0.0f}}});
  std::vector<double> crossings;
  float before = kAngle;
  run(b.finalize(), 6000, {.angular_damping = 0.0f, .joint_attach_ke = 2e4f},
      [&](int t, const SimState& s) {
        const float angle = 2.0f * s.body_q.to_host()[0].q.y;
        if (before > 0.0f && angle <= 0.0f)
          crossings.push_back((t + static_cast<double>(before / (before - angle))) * kDt);
        before = angle;
      });
  ASSERT_GE(crossings.size(), 3u);
  const double period =
      (crossings.back() - crossings.front()) / static_cast<double>(crossings.size() - 1);
  const double expected =
      2.0 * kPi * std::sqrt((kInertia + kMass * kLength * kLength) / (kMass * 9.81 * kLength));
  // The amplitude contributes 1.6e-4 of the period. The anchor yields by m g / ke = 1 mm.
  EXPECT_NEAR(period, expected, 2e-3 * expected);
}

struct Momentum {
  Vec3<double> linear{}, angular{};
};
Momentum momentum(const Model& m, const SimState& s) {
  Momentum sum;
  const auto q = s.body_q.to_host();
  const auto qd = s.body_qd.to_host();
  const auto com = m.body_com.to_host();
  const auto mass = m.body_mass.to_host();
  const auto inertia = m.body_inertia.to_host();
  const auto to_double = [](const Vec3f& v) { return Vec3<double>{v.x, v.y, v.z}; };
  for (size_t b = 0; b < q.size(); ++b) {
    const Vec3f c = math::transform_point(q[b], com[b]);
    const Vec3f w = math::rotate_inverse(q[b].q, qd[b].angular);
    const Vec3f turned = {inertia[b].m[0][0] * w.x, inertia[b].m[1][1] * w.y,
                          inertia[b].m[2][2] * w.z};
    const Vec3f spin = math::rotate(q[b].q, turned);
    const Vec3<double> p = to_double(qd[b].linear) * static_cast<double>(mass[b]);
    sum.linear = sum.linear + p;
    sum.angular = sum.angular + math::cross(to_double(c), p) + to_double(spin);
  }
  return sum;
}

double length(const Vec3<double>& v) { return std::sqrt(math::dot(v, v)); }

class JointTypes : public ::testing::TestWithParam<JointType> {};

JointArgs args_of(JointType type) {
  JointArgs args{.parent_xform = {{0.3f, 0.0f, 0.0f}, about({0.0f, 0.0f, 1.0f}, 0.4f)},
                 .child_xform = at(-0.3f, 0.0f, 0.0f)};
  const JointDofConfig drive{.axis = {0.0f, 1.0f, 0.0f},
                             .limit_lower = -0.2f,
                             .limit_upper = 0.2f,
                             .limit_ke = 50.0f,
                             .limit_kd = 1.0f,
                             .target_q = 0.15f,
                             .target_ke = 5.0f,
                             .target_kd = 0.5f};
  JointDofConfig other = drive;
  other.axis = {1.0f, 0.0f, 0.0f};
  if (type == JointType::REVOLUTE) args.angular_axes = {drive};
  if (type == JointType::PRISMATIC) args.linear_axes = {drive};
  if (type == JointType::D6) {
    args.linear_axes = {other};
    args.angular_axes = {drive, other};
  }
  return args;
}

std::shared_ptr<Model> pair_of_bodies(JointType type) {
  ModelBuilder b(Axis::Z, 0.0f);
  b.add_link(body(kOrigin));
  b.add_link(body({{0.3f + 0.3f * std::cos(0.4f), 0.3f * std::sin(0.4f), 0.0f},
                   about({0.0f, 0.0f, 1.0f}, 0.4f)},
                  2.0f, 0.3f));
  b.add_joint_free(0);
  if (type == JointType::DISTANCE) {
    b.add_joint_distance(0, 1, {.min_distance = 0.57f, .max_distance = 0.6f});
  } else {
    b.add_joint(type, 0, 1, args_of(type));
  }
  b.body_qd[0] = {{0.3f, -0.2f, 0.1f}, {0.5f, 1.0f, -0.5f}};
  b.body_qd[1] = {{-0.1f, 0.4f, 0.2f}, {-1.0f, 0.5f, 1.0f}};
  return b.finalize();
}

TEST_P(JointTypes, APairKeepsItsMomentum) {
  const auto model = pair_of_bodies(GetParam());
  const Momentum start = momentum(*model, model->state());
  const SimState end =
      run(model, 960, {.angular_damping = 0.0f, .joint_attach_ke = 1e3f, .joint_attach_kd = 10.0f});
  const Momentum after = momentum(*model, end);
  EXPECT_LT(length(after.linear - start.linear), 1e-5);
  // Forces at anchors that are x apart turn the pair by x cross kd v; the gyroscopic term is
  // explicit.
  EXPECT_LT(length(after.angular - start.angular), 5e-3 * length(start.angular));
  for (const Transformf& x : end.body_q.to_host()) EXPECT_TRUE(std::isfinite(x.p.x));
}

TEST_P(JointTypes, TheResultDoesNotDependOnTheThreads) {
  const auto model = pair_of_bodies(GetParam());
  const SimState a = run(model, 50, {}), b = run(model, 50, {});
  EXPECT_TRUE(testing::same_bits(std::span<const Transformf>(a.body_q.to_host()),
                                 std::span<const Transformf>(b.body_q.to_host())));
}

INSTANTIATE_TEST_SUITE_P(All, JointTypes,
                         ::testing::Values(JointType::REVOLUTE, JointType::PRISMATIC,
                                           JointType::BALL, JointType::FIXED, JointType::DISTANCE,
                                           JointType::D6),
                         [](const auto& type) { return std::string(joint_type_name(type.param)); });

// A slider on a rail along z, hanging on its drive: z = target - m g / ke.
TEST(PenaltyJoints, ADriveHoldsWhereItsSpringSays) {
  const auto rest = [](JointDofConfig dof) {
    dof.axis = {0.0f, 0.0f, 1.0f};
    ModelBuilder b;
    b.add_link(body(kOrigin, 2.0f));
    b.add_joint_prismatic(-1, 0, {.dof = dof});
    return run(b.finalize(), 6000, {}).body_q.to_host()[0].p.z;
  };
  const float weight = 2.0f * 9.81f;
  const JointDofConfig drive{.target_q = 0.3f, .target_ke = 200.0f, .target_kd = 20.0f};
  EXPECT_NEAR(rest(drive), 0.3f - weight / 200.0f, 1e-4f);
  // POSITION leaves target_qd out, which shifts rest by kd qd* / ke.
  JointDofConfig moving = drive;
  moving.target_qd = 1.0f;
  EXPECT_NEAR(rest(moving), 0.3f + 0.1f - weight / 200.0f, 1e-4f);
  moving.actuator_mode = JointTargetMode::POSITION;
  EXPECT_NEAR(rest(moving), 0.3f - weight / 200.0f, 1e-4f);
  // Without a drive the body comes to rest below the lower limit by m g / limit_ke.
  JointDofConfig limited{
      .limit_lower = -0.5f, .limit_upper = 0.5f, .limit_ke = 1e3f, .limit_kd = 50.0f};
  EXPECT_NEAR(rest(limited), -0.5f - weight / 1e3f, 1e-4f);
  // A drive with an effort limit of half the weight cannot hold the body.
  JointDofConfig weak = limited;
  weak.target_ke = 1e4f;
  weak.effort_limit = weight / 2.0f;
  EXPECT_NEAR(rest(weak), -0.5f - weight / 1e3f, 1e-3f);
  weak.effort_limit = 1e6f;
  weak.target_kd = 100.0f;
  EXPECT_NEAR(rest(weak), -weight / 1e4f, 1e-4f);
}

TEST(PenaltyJoints, AVelocityDriveReachesItsVelocity) {
  ModelBuilder b(Axis::Z, 0.0f);
  b.add_link(body(kOrigin));
  b.add_joint_revolute(-1, 0,
                       {.dof = JointDofConfig{.axis = {0.0f, 1.0f, 0.0f},
                                              .target_q = 5.0f,
                                              .target_qd = 2.0f,
                                              .target_ke = 100.0f,
                                              .target_kd = 5.0f,
                                              .actuator_mode = JointTargetMode::VELOCITY}});
  const SimState end = run(b.finalize(), 1000, {.angular_damping = 0.0f});
  EXPECT_NEAR(end.body_qd.to_host()[0].angular.y, 2.0f, 1e-3f);
}

TEST(PenaltyJoints, ADistanceIsHeld) {
  ModelBuilder b;
  b.add_link(body(at(1.0f, 0.0f, 0.0f)));
  b.add_joint_distance(-1, 0, {.min_distance = 0.9f, .max_distance = 1.0f, .limit_ke = 1e4f});
  float longest = 0.0f;
  const SimState end = run(b.finalize(), 3000, {}, [&](int, const SimState& s) {
    longest = std::max(longest, math::length(s.body_q.to_host()[0].p));
  });
  // 3 m g at the lowest point of the swing, over ke.
  EXPECT_LT(longest, 1.0f + 2.0f * 3.0f * 9.81f / 1e4f);
  EXPECT_GT(longest, 1.0f);
  ModelBuilder push(Axis::Z, 0.0f);
  push.add_link(body(at(0.5f, 0.0f, 0.0f)));
  push.add_joint_distance(-1, 0, {.min_distance = 0.9f, .max_distance = -1.0f, .limit_kd = 100.0f});
  float x = 0.0f;
  run(push.finalize(), 400, {}, [&](int, const SimState& s) { x = s.body_q.to_host()[0].p.x; });
  EXPECT_GT(x, 0.9f);
}

TEST(PenaltyJoints, AFixedJointTakesTheShorterWayRound) {
  // -q is the rotation of q: both give one moment, of the angle 0.2.
  const Quatf q = about({0.0f, 0.0f, 1.0f}, 0.2f);
  const auto moment = [](const Quatf& r) {
    const JointBody<float> child{.q = {{}, r}};
    return penalty_joint_wrench<float>(joint_frames<float>({}, child, kOrigin, kOrigin), nullptr, 0,
                                       0, false, {.ke = 10.0f, .kd = 0.0f})
        .parent.angular.z;
  };
  EXPECT_NEAR(moment(q), 2.0f, 1e-5f);
  EXPECT_NEAR(moment({-q.x, -q.y, -q.z, -q.w}), 2.0f, 1e-5f);
  EXPECT_NEAR(moment(about({0.0f, 0.0f, 1.0f}, 1e-5f)), 1e-4f, 1e-9f);
}

TEST(PenaltyJoints, AHingeBeyondHalfATurnKeepsTheSignOfItsLimit) {
  const auto force = [](float angle) {
    JointDof<float> dof{.axis = {0.0f, 0.0f, 1.0f},
                        .limit = {.lower = -3.0f, .upper = 3.0f, .ke = 1.0f},
                        .effort_limit = 1e6f};
    const JointBody<float> child{.q = {{}, about({0.0f, 0.0f, 1.0f}, angle)}};
    return penalty_joint_wrench<float>(joint_frames<float>({}, child, kOrigin, kOrigin), &dof, 0, 1,
                                       false, {})
        .child.angular.z;
  };
  EXPECT_NEAR(force(3.1f), -0.1f, 1e-5f);
  EXPECT_NEAR(force(3.1f - 2.0f * kPi), -0.1f, 1e-5f);  // the same pose
  EXPECT_NEAR(force(-3.1f), 0.1f, 1e-5f);
}

// The moments of a D6 do the work of its coordinates: -dE/dq for E = 1/2 ke q^2.
TEST(PenaltyJoints, AD6HasTheAnglesOfItsAxes) {
  const Vec3f axes[] = {{0.0f, 1.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 1.0f}};  // left-handed
  const float q[] = {0.5f, -0.7f, 0.9f};
  const Quatf r = math::multiply(math::multiply(about(axes[0], q[0]), about(axes[1], q[1])),
                                 about(axes[2], q[2]));
  for (int driven = 0; driven < 3; ++driven) {
    JointDof<float> dofs[3];
    for (int k = 0; k < 3; ++k)
      dofs[k] = {.axis = axes[k], .limit = {.lower = -9.0f, .upper = 9.0f}, .effort_limit = 1e6f};
    dofs[driven].target_ke = 2.0f;
    const JointBody<float> child{.q = {{}, r}};
    const Vec3f t = penalty_joint_wrench<float>(joint_frames<float>({}, child, kOrigin, kOrigin),
                                                dofs, 0, 3, false, {})
                        .child.angular;
    // Turning about each transported axis moves that angle alone.
    const Vec3f turned[] = {axes[0], math::rotate(about(axes[0], q[0]), axes[1]),
                            math::rotate(r, axes[2])};
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(math::dot(t, turned[k]), k == driven ? -2.0f * q[k] : 0.0f, 1e-5f) << driven;
  }
}

TEST(PenaltyJoints, AKinematicParentCarriesItsChild) {
  ModelBuilder b(Axis::Z, 0.0f);
  b.add_body({.is_kinematic = true});
  b.add_link(body(at(0.5f, 0.0f, 0.0f)));
  b.add_joint_fixed(0, 1, {.parent_xform = at(0.5f, 0.0f, 0.0f)});
  b.body_qd[0] = {{0.0f, 0.2f, 0.0f}, {}};
  b.body_qd[1] = {{0.0f, 0.2f, 0.0f}, {}};
  const SimState end = run(b.finalize(), 960, {});
  EXPECT_NEAR(end.body_q.to_host()[0].p.y, 0.2f, 1e-5f);
  EXPECT_NEAR(end.body_q.to_host()[1].p.y, 0.2f, 1e-4f);
}

TEST(PenaltyJoints, ForcesOfTheControlActAndDisabledJointsDoNot) {
  ModelBuilder b(Axis::Z, 0.0f);
  b.add_body(body(kOrigin, 2.0f));
  b.add_link(body(at(3.0f, 0.0f, 0.0f), 2.0f));
  b.add_joint_prismatic(-1, 1, {.parent_xform = at(3.0f, 0.0f, 0.0f), .enabled = false});
  b.joint_f[1] = 4.0f;
  const auto model = b.finalize();
  EXPECT_NEAR(run(model, 960, {}).body_qd.to_host()[0].linear.y, 2.0f, 1e-4f);
  Control control = model->control();
  control.joint_f.copy_from_host(std::vector<float>{6.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 9.0f});
  const SimState end = run(
      model, 960, {}, [](int, const SimState&) {}, &control);
  EXPECT_NEAR(end.body_qd.to_host()[0].linear.x, 3.0f, 1e-4f);
  EXPECT_EQ(end.body_qd.to_host()[1].linear.x, 0.0f);
}

TEST(PenaltyJoints, WhatTheyDoNotHaveIsRefused) {
  const auto hinge = [](const JointDofConfig& dof, float mass = 1.0f) {
    ModelBuilder b;
    mass > 0.0f ? b.add_link(body(kOrigin, mass)) : b.add_link({});
    b.add_joint_revolute(-1, 0, {.dof = dof});
    return b.finalize();
  };
  EXPECT_ERROR(SolverSemiImplicit(hinge({.armature = 1.0f})), ErrorKind::NotImplemented,
               "joint_armature[0]");
  EXPECT_ERROR(SolverSemiImplicit(hinge({.friction = 1.0f})), ErrorKind::NotImplemented,
               "joint_friction[0]");
  EXPECT_ERROR(SolverSemiImplicit(hinge({.velocity_limit = 1.0f})), ErrorKind::NotImplemented,
               "joint_velocity_limit[0]");
  EXPECT_ERROR(SolverSemiImplicit(hinge({}, 0.0f)), ErrorKind::Value,
               "penalty joints do not move a link without mass");
  ModelBuilder ball;
  ball.add_link(body(kOrigin));
  ball.add_joint_ball(-1, 0);
  ball.joint_limit_upper[1] = 1.0f;
  EXPECT_ERROR(SolverSemiImplicit(ball.finalize()), ErrorKind::NotImplemented,
               "joint_limit_upper[1]: expected 1e+10 of a BALL joint");
  ModelBuilder oblique;
  oblique.add_link(body(kOrigin));
  oblique.add_joint_d6(-1, 0, {.angular_axes = {{}, {.axis = {1.0f, 1.0f, 0.0f}}}});
  EXPECT_ERROR(SolverSemiImplicit(oblique.finalize()), ErrorKind::NotImplemented,
               "expected perpendicular axes of a D6 joint");
}

// ke dt^2 / I + 2 (0.01 kd) dt / I < 4 about the directions that a hinge holds.
TEST(PenaltyJoints, AStepAboveTheStableOneIsRefused) {
  const auto model = [](const Vec3f& axis, float arm) {
    ModelBuilder b(Axis::Z, 0.0f);
    b.add_link({.mass = 2.0f, .inertia = diagonal(0.05f, 0.05f, 0.002f)});
    b.add_joint_revolute(-1, 0,
                         {.child_xform = at(arm, 0.0f, 0.0f), .dof = JointDofConfig{.axis = axis}});
    b.body_qd[0].angular = {0.001f, 0.001f, 0.001f};
    return b.finalize();
  };
  const SemiImplicitOptions options = {.joint_attach_kd = 10.0f};
  // Returns the angular speed after some steps of dt (rad/s).
  const auto speed = [&](const std::shared_ptr<Model>& m, float dt) {
    SolverSemiImplicit solver(m, options);
    SimState now = m->state(), next = m->state();
    for (int t = 0; t < 400; ++t) {
      solver.step(now, next, nullptr, nullptr, dt);
      std::swap(now, next);
    }
    return math::length(now.body_qd.to_host()[0].angular);
  };
  // The positive root, for the slender axis.
  const float k = 1e4f / 0.002f, c = 0.1f / 0.002f, limit = (-c + std::sqrt(c * c + 4.0f * k)) / k;
  EXPECT_LT(speed(model({1.0f, 0.0f, 0.0f}, 0.0f), 0.99f * limit), 0.01f);
  EXPECT_ERROR(speed(model({1.0f, 0.0f, 0.0f}, 0.0f), 1.001f * limit), ErrorKind::Value,
               "above it joint 0 diverges with joint_attach_ke 10000");
  // The link is free about its own axis. The joint holds the other axes, which have more inertia.
  EXPECT_LT(speed(model({0.0f, 0.0f, 1.0f}, 0.0f), 2.0f * limit), 0.01f);
  // A transverse force with an arm of 0.5 m along x rotates the link: w = 1/2 + 0.25 / 0.002.
  const float w = 0.5f + 0.25f / 0.002f, far = 4.0f / w / (10.0f + std::sqrt(100.0f + 4e4f / w));
  EXPECT_NO_THROW(speed(model({0.0f, 0.0f, 1.0f}, 0.5f), 0.99f * far));
  EXPECT_ERROR(speed(model({0.0f, 0.0f, 1.0f}, 0.5f), 1.01f * far), ErrorKind::Value, "diverges");
}

}  // namespace
}  // namespace novaphy
