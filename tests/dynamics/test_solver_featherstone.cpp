#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "support/npz.h"

namespace novaphy {
namespace {

using testing::Npz;

const Npz& newton() {
  static const Npz file(NOVAPHY_GOLDEN_DIR "/newton_2r_strict.npz");
  return file;
}

// The planar arm of newton_2r_strict.npz: two links in XOZ on +Y hinges.
struct ArmOptions {
  JointDofConfig dof = {};
  Vec3f base = {};
  bool reversed_bodies = false;
};
ModelBuilder arm(const ArmOptions& options = {}) {
  ModelBuilder b;
  const BodyArgs link{
      .mass = 1.0f,
      .inertia = Mat33f{{{0.0025f, 0, 0}, {0, 1.0f / 48.0f, 0}, {0, 0, 1.0f / 48.0f}}},
      .lock_inertia = true};
  int32_t body[2] = {b.add_link(link), b.add_link(link)};
  if (options.reversed_bodies) std::swap(body[0], body[1]);
  JointDofConfig dof = options.dof;
  dof.axis = {0, 1, 0};
  const Transformf in_child = {{-0.25f, 0, 0}, Quatf::identity()};
  const int32_t joints[2] = {
      b.add_joint_revolute(
          -1, body[0],
          {.parent_xform = {options.base, Quatf::identity()}, .child_xform = in_child, .dof = dof}),
      b.add_joint_revolute(body[0], body[1],
                           {.parent_xform = {{0.25f, 0, 0}, Quatf::identity()},
                            .child_xform = in_child,
                            .dof = dof})};
  b.add_articulation(joints);
  b.joint_q = {0.4f, -0.6f};
  b.joint_qd = {1.0f, -0.5f};
  return b;
}

struct Motion {
  std::vector<float> q, qd;  // state after state
};
Motion run(const ModelBuilder& builder, const FeatherstoneOptions& options, int steps = 576,
           float dt = 1.0f / 960.0f) {
  const auto model = builder.finalize();
  SolverFeatherstone solver(model, options);
  SimState a = model->state(), b = model->state();
  Motion r;
  const auto keep = [&](const SimState& s) {
    for (const float x : s.joint_q.to_host()) r.q.push_back(x);
    for (const float x : s.joint_qd.to_host()) r.qd.push_back(x);
  };
  keep(a);
  for (int t = 0; t < steps; ++t) {
    solver.step(a, b, nullptr, nullptr, dt);
    std::swap(a, b);
    keep(a);
  }
  return r;
}

double worst(const std::vector<float>& x, const std::string& key) {
  const auto expected = newton()[key].as<float>();
  EXPECT_EQ(x.size(), expected.size());
  double most = 0.0;
  for (size_t i = 0; i < x.size(); ++i)
    most = std::fmax(most, std::abs(static_cast<double>(x[i]) - expected[i]));
  return most;
}

TEST(SolverFeatherstone, FollowsNewtonOverFreeMotion) {
  const Motion r = run(arm(), {.angular_damping = 0.0f});
  EXPECT_LT(worst(r.q, "free_joint_q"), 1e-5);
  EXPECT_LT(worst(r.qd, "free_joint_qd"), 1e-4);
}

TEST(SolverFeatherstone, FollowsNewtonsExplicitLimits) {
  ModelBuilder b = arm();
  b.joint_limit_lower = {-0.9f, -0.8f};
  b.joint_limit_upper = {1.2f, 0.7f};
  b.joint_limit_ke = {1000.0f, 1000.0f};
  b.joint_limit_kd = {5.0f, 5.0f};
  const Motion r = run(b, {.angular_damping = 0.0f, .implicit_drives = false});
  EXPECT_LT(worst(r.q, "limits_joint_q"), 1e-5);
}

TEST(SolverFeatherstone, FollowsNewtonUnderTorqueAndArmature) {
  ModelBuilder b = arm();
  b.joint_armature = {0.02f, 0.02f};
  b.joint_f = {1.5f, -0.4f};
  const Motion r = run(b, {.angular_damping = 0.0f});
  EXPECT_LT(worst(r.q, "motor_joint_q"), 1e-5);
}

// Newton's mass matrix is wrong where bodies are in another order than joints (its qdd by 1, here).
TEST(SolverFeatherstone, DoesNotDependOnTheOrderOfBodies) {
  const Motion a = run(arm(), {}), b = run(arm({.reversed_bodies = true}), {});
  EXPECT_EQ(a.q, b.q);
  EXPECT_EQ(a.qd, b.qd);
}

// Newton's joint_q is off by 1.4e-2 at 100 m, and NaN here.
TEST(SolverFeatherstone, MovesTheSameAKilometreAway) {
  const Motion a = run(arm(), {}), b = run(arm({.base = {1000.0f, 1000.0f, 0.0f}}), {});
  EXPECT_EQ(a.q, b.q);
  EXPECT_EQ(a.qd, b.qd);
}

TEST(SolverFeatherstone, MovesEveryWorldAsIfItWereAlone) {
  const Motion alone = run(arm(), {}, 100);
  ModelBuilder many;
  many.replicate(arm(), 37, {3.0f, 0.0f, 0.0f});
  const Motion all = run(many, {}, 100);
  for (size_t t = 0; t <= 100; ++t)
    for (size_t w = 0; w < 37; ++w)
      for (size_t k = 0; k < 2; ++k)
        ASSERT_EQ(all.q[(t * 37 + w) * 2 + k], alone.q[2 * t + k]) << t << " " << w;
}

TEST(SolverFeatherstone, DampsAngularRatesBehindThePositions) {
  const Motion damped = run(arm(), {.angular_damping = 0.5f}, 1),
               free = run(arm(), {.angular_damping = 0}, 1);
  EXPECT_EQ(damped.q[2], free.q[2]);
  EXPECT_NEAR(damped.qd[2], free.qd[2] * (1.0f - 0.5f / 960.0f), 1e-6);
}

// A D6 with two angular axes is two hinges.
TEST(SolverFeatherstone, TakesD6JointsForTheirChain) {
  const auto tip = [](bool d6) {
    ModelBuilder b;
    const BodyArgs link{.com = {0.1f, 0, 0},
                        .mass = 1.0f,
                        .inertia = Mat33f{{{0.02f, 0, 0}, {0, 0.03f, 0}, {0, 0, 0.04f}}},
                        .lock_inertia = true};
    JointDofConfig first, second;
    first.axis = {0, 1, 0};
    second.axis = {0, 0, 1};
    const int32_t body = b.add_link(link);
    std::vector<int32_t> joints;
    if (d6) {
      joints.push_back(b.add_joint_d6(-1, body, {.angular_axes = {first, second}}));
    } else {
      const int32_t between = b.add_link({});
      joints.push_back(b.add_joint_revolute(-1, between, {.dof = first}));
      joints.push_back(b.add_joint_revolute(between, body, {.dof = second}));
    }
    b.add_articulation(joints);
    b.joint_q = {0.3f, 0.2f};
    b.joint_qd = {1.0f, 2.0f};
    return run(b, {}, 200);
  };
  const Motion a = tip(true), b = tip(false);
  EXPECT_EQ(a.q, b.q);
}

// Returns the error message of a step, or "" without an error.
std::string refusal(const ModelBuilder& builder, const std::function<void(Model&)>& edit) {
  const auto model = builder.finalize();
  edit(*model);
  try {
    SolverFeatherstone solver(model);
    SimState a = model->state(), b = model->state();
    solver.step(a, b, nullptr, nullptr, 0.001f);
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}
TEST(SolverFeatherstone, RefusesValuesWithoutEffect) {
  const auto has = [](const std::string& text, const char* word) {
    return text.find(word) != std::string::npos;
  };
  const auto set = [](DeviceArray<float> Model::*array) {
    return [array](Model& m) { (m.*array).mutable_data()[0] = 0.5f; };
  };
  EXPECT_EQ(refusal(arm(), [](Model&) {}), "");
  EXPECT_TRUE(has(refusal(arm(), set(&Model::joint_act)), "joint_act[0]"));
  EXPECT_TRUE(has(refusal(arm(), [](Model& m) { m.joint_enabled.mutable_data()[1] = 0; }),
                  "joint_enabled[1]"));
  ModelBuilder free;
  free.add_body({.mass = 1.0f, .inertia = Mat33f{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}});
  EXPECT_EQ(refusal(free, [](Model&) {}), "");
  EXPECT_TRUE(has(refusal(free, set(&Model::joint_target_ke)), "joint_target_ke[0]"));
  EXPECT_TRUE(has(refusal(free, set(&Model::joint_damping)), "joint_damping[0]"));
  EXPECT_TRUE(has(refusal(free, set(&Model::joint_limit_upper)), "joint_limit_upper[0]"));
  ModelBuilder particles = arm();
  particles.add_particle({}, {}, 1.0f);
  EXPECT_TRUE(has(refusal(particles, [](Model&) {}), "particle_count"));
}

TEST(SolverFeatherstone, NamesTheDofThatHasNoInertia) {
  const std::string text = refusal(arm(), [](Model& m) {
    m.body_mass.fill(0.0f);
    m.body_inertia.fill(Mat33f{});
  });
  EXPECT_NE(text.find("dof 1 (joint 'joint_1')"), std::string::npos) << text;
}

// Every array of drives acts.
TEST(SolverFeatherstone, EveryArrayOfDrivesChangesTheStep) {
  ModelBuilder b = arm();
  b.joint_target_ke = {100.0f, 100.0f};
  b.joint_target_kd = {1.0f, 1.0f};
  b.joint_limit_lower = {-2.0f, -0.5f};  // the second is outside
  b.joint_target_q[1] = -1.0f;           // and pressed outwards
  const auto next = [&](const std::function<void(Model&)>& edit) {
    const auto model = b.finalize();
    edit(*model);
    SolverFeatherstone solver(model);
    SimState x = model->state(), y = model->state();
    solver.step(x, y, nullptr, nullptr, 0.01f);
    return y.joint_qd.to_host();
  };
  const std::vector<float> plain = next([](Model&) {});
  const auto changes = [&](DeviceArray<float> Model::*array, size_t row, float value) {
    return next([&](Model& m) { (m.*array).mutable_data()[row] = value; }) != plain;
  };
  EXPECT_TRUE(changes(&Model::joint_target_q, 0, 0.7f));
  EXPECT_TRUE(changes(&Model::joint_target_qd, 0, 0.7f));
  EXPECT_TRUE(changes(&Model::joint_target_ke, 0, 50.0f));
  EXPECT_TRUE(changes(&Model::joint_target_kd, 0, 2.0f));
  EXPECT_TRUE(changes(&Model::joint_damping, 0, 2.0f));
  EXPECT_TRUE(changes(&Model::joint_armature, 0, 2.0f));
  EXPECT_TRUE(changes(&Model::joint_f, 0, 2.0f));
  EXPECT_TRUE(changes(&Model::joint_limit_lower, 1, -0.2f));
  EXPECT_TRUE(changes(&Model::joint_limit_upper, 0, 0.1f));
  EXPECT_TRUE(changes(&Model::joint_limit_ke, 1, 1.0f));
  EXPECT_TRUE(changes(&Model::joint_limit_kd, 1, 100.0f));
  EXPECT_TRUE(changes(&Model::joint_effort_limit, 0, 0.5f));
  EXPECT_TRUE(changes(&Model::joint_velocity_limit, 0, 0.5f));
  EXPECT_NE(next([](Model& m) { m.joint_target_mode.mutable_data()[0] = 0; }), plain);
}

}  // namespace
}  // namespace novaphy
