// Joints and articulations in ModelBuilder and Model: layout, worlds, filters, bad input.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
const float kHalf = std::sqrt(0.5f);
const Transformf kTurned = {{1.0f, 2.0f, 3.0f}, {0.0f, 0.0f, kHalf, kHalf}};  // 90 deg about z

BodyArgs link(float mass = 1.0f) {
  return {.mass = mass,
          .inertia = Mat33f{{{0.1f, 0.0f, 0.0f}, {0.0f, 0.1f, 0.0f}, {0.0f, 0.0f, 0.1f}}}};
}

// One joint of each type in a chain, and its articulation.
ModelBuilder chain() {
  ModelBuilder b;
  for (int k = 0; k < 7; ++k) b.add_link(link());
  b.add_joint_revolute(-1, 0,
                       {.dof = JointDofConfig{.axis = {0.0f, 2.0f, 0.0f}, .target_q = 0.5f}});
  b.add_joint_prismatic(0, 1);
  b.add_joint_ball(1, 2, {.damping = 0.25f});
  b.add_joint_fixed(2, 3);
  b.add_joint_free(4, {.parent = 3});
  b.add_joint_distance(3, 5, {.min_distance = -1.0f, .max_distance = 2.0f});
  b.add_joint_d6(5, 6,
                 {.linear_axes = {JointDofConfig{.axis = {0.0f, 0.0f, 1.0f}}},
                  .angular_axes = {JointDofConfig{}, JointDofConfig{.axis = {0.0f, 1.0f, 0.0f}}}});
  std::vector<int32_t> joints(7);
  std::iota(joints.begin(), joints.end(), 0);
  b.add_articulation(joints);
  return b;
}

TEST(Joints, StartsAndSizesFollowTheTypes) {
  const auto m = chain().finalize();
  EXPECT_EQ(m->joint_count(), 7);
  EXPECT_EQ(m->joint_q_start.to_host(), (std::vector<int32_t>{0, 1, 2, 6, 6, 13, 20, 23}));
  EXPECT_EQ(m->joint_qd_start.to_host(), (std::vector<int32_t>{0, 1, 2, 5, 5, 11, 17, 20}));
  EXPECT_EQ(m->joint_coord_count(), 23);
  EXPECT_EQ(m->joint_dof_count(), 20);
  EXPECT_EQ(m->joint_dof_dim.to_host()[6], (Vec2i{1, 2}));
  EXPECT_EQ(m->joint_axis.to_host()[0], (Vec3f{0.0f, 1.0f, 0.0f}));
  EXPECT_EQ(m->joint_ancestor.to_host(), (std::vector<int32_t>{-1, 0, 1, 2, 3, 3, 5}));
  EXPECT_EQ(m->articulation_start.to_host(), (std::vector<int32_t>{0, 7}));
  EXPECT_EQ(m->articulation_end.to_host(), (std::vector<int32_t>{7}));
  EXPECT_EQ(m->max_dofs_per_articulation, 20);
  EXPECT_EQ(m->joint_limit_lower.to_host()[11], -kJointUnlimited);
  EXPECT_EQ(m->joint_limit_upper.to_host()[11], 2.0f);
  EXPECT_EQ(m->joint_damping.to_host()[3], 0.25f);
  const auto q = m->joint_q.to_host(), target = m->joint_target_q.to_host();
  EXPECT_EQ(target[0], 0.5f);  // the coordinate itself starts at 0
  EXPECT_EQ(q[0], 0.0f);
  for (const size_t w : {5u, 12u, 19u}) {
    EXPECT_EQ(q[w], 1.0f);
    EXPECT_EQ(target[w], 1.0f);
  }
  EXPECT_EQ(m->control().joint_target_q.to_host(), target);
  EXPECT_EQ(m->state().joint_q.to_host(), q);
}

TEST(Joints, ABodyOfItsOwnHasAFreeJointThatFollowsItsPose) {
  ModelBuilder b;
  BodyArgs args = link();
  args.xform = kTurned;
  const int32_t body = b.add_body(args);
  EXPECT_EQ(b.joint_count(), 1);
  EXPECT_EQ(b.articulation_count(), 1);
  b.body_q[0].p.x = 5.0f;
  b.body_qd[0] = {{1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}};
  const auto m = b.finalize();
  EXPECT_EQ(m->joint_child.to_host()[0], body);
  EXPECT_EQ(m->joint_q.to_host(), (std::vector<float>{5, 2, 3, 0, 0, kHalf, kHalf}));
  EXPECT_EQ(m->joint_qd.to_host(), (std::vector<float>{1, 2, 3, 4, 5, 6}));
  b.joint_q[2] = 9.0f;  // an edited entry no longer follows body_q
  EXPECT_EQ(b.finalize()->joint_q.to_host(), (std::vector<float>{1, 2, 9, 0, 0, kHalf, kHalf}));
}

TEST(Joints, CopiesInWorldsShiftEveryIndexAndMoveTheRoots) {
  ModelBuilder arm;
  arm.add_link(link());
  arm.add_link(link());
  arm.add_joint_revolute(-1, 0, {.parent_xform = {{0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 0.0f, 1.0f}}});
  arm.add_joint_revolute(0, 1);
  arm.add_articulation(std::array{0, 1});
  arm.add_body(link());
  arm.joint_qd[2] = 1.0f;  // the free body moves along x
  ModelBuilder b;
  b.add_world(arm);
  b.add_world(arm, kTurned);
  const auto m = b.finalize();
  EXPECT_EQ(m->joint_parent.to_host(), (std::vector<int32_t>{-1, 0, -1, -1, 3, -1}));
  EXPECT_EQ(m->joint_child.to_host(), (std::vector<int32_t>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(m->joint_ancestor.to_host(), (std::vector<int32_t>{-1, 0, -1, -1, 3, -1}));
  EXPECT_EQ(m->joint_articulation.to_host(), (std::vector<int32_t>{0, 0, 1, 2, 2, 3}));
  EXPECT_EQ(m->articulation_start.to_host(), (std::vector<int32_t>{0, 2, 3, 5, 6}));
  EXPECT_EQ(m->joint_world.to_host(), (std::vector<int32_t>{0, 0, 0, 1, 1, 1}));
  EXPECT_EQ(m->joint_q_start.to_host(), (std::vector<int32_t>{0, 1, 2, 9, 10, 11, 18}));
  // A fixed base moves by its anchor, a free body by its coordinates.
  EXPECT_EQ(m->joint_X_p.to_host()[3],
            math::multiply(kTurned, {{0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 0.0f, 1.0f}}));
  const auto q = m->joint_q.to_host(), qd = m->joint_qd.to_host();
  EXPECT_EQ(std::vector<float>(q.begin() + 11, q.end()),
            (std::vector<float>{1, 2, 3, 0, 0, kHalf, kHalf}));
  EXPECT_NEAR(qd[10], 0.0f, 1e-6f);
  EXPECT_NEAR(qd[11], 1.0f, 1e-6f);
}

TEST(Joints, ShapesOfConnectedBodiesDoNotMeet) {
  const auto pairs = [](bool joint_filters, bool shape_filters) {
    ModelBuilder b;
    for (int k = 0; k < 3; ++k) b.add_link(link());
    b.add_joint_free(0);
    b.add_joint_revolute(0, 1, {.collision_filter_parent = joint_filters});
    b.add_joint_revolute(1, 2);
    for (int k = 0; k < 3; ++k)
      b.add_shape_sphere(k, {.cfg = ShapeConfig{.collision_filter_parent = shape_filters}});
    b.add_shape_sphere(-1);
    return b.finalize()->shape_contact_pairs().to_host();
  };
  EXPECT_EQ(pairs(true, true), (std::vector<Vec2i>{{0, 2}, {0, 3}, {1, 3}, {2, 3}}));
  EXPECT_EQ(pairs(false, true), (std::vector<Vec2i>{{0, 1}, {0, 2}, {0, 3}, {1, 3}, {2, 3}}));
  EXPECT_EQ(pairs(true, false).size(), 6u);
}

TEST(Joints, AMasslessLinkIsLegalAndALinkWithoutAJointIsNot) {
  ModelBuilder b;
  b.add_link();
  EXPECT_ERROR(b.finalize(), ErrorKind::Value, "body 0 (\"body_0\"): expected a joint");
  b.add_joint_fixed(-1, 0);
  EXPECT_EQ(b.finalize()->body_mass.to_host()[0], 0.0f);
}

TEST(Joints, BadJointsAreRefusedAndLeaveNothingBehind) {
  ModelBuilder b = chain();
  const auto expect = [&](auto&& add, ErrorKind kind, const char* what) {
    EXPECT_ERROR(add(), kind, what);
    EXPECT_EQ(b.joint_count(), 7);
    EXPECT_EQ(b.joint_dof_count(), 20);
    EXPECT_NO_THROW(b.finalize());
  };
  expect([&] { b.add_joint_fixed(-1, 7); }, ErrorKind::Index, "child: expected 0 to 6, got 7");
  expect([&] { b.add_joint_fixed(-2, 1); }, ErrorKind::Index, "parent: expected -1");
  expect([&] { b.add_joint_fixed(1, 1); }, ErrorKind::Value, "two different bodies");
  const auto revolute = [&](const JointDofConfig& dof) {
    return [&b, dof] { b.add_joint_revolute(0, 6, {.dof = dof}); };
  };
  expect(revolute({.axis = {0.0f, 0.0f, 0.0f}}), ErrorKind::Value,
         "axis: expected a finite vector");
  expect(revolute({.axis = {kNan, 0.0f, 0.0f}}), ErrorKind::Value, "axis");
  expect(revolute({.limit_lower = 1.0f, .limit_upper = -1.0f}), ErrorKind::Value,
         "expected the lower one first, got 1 and -1");
  expect(revolute({.target_ke = -1.0f}), ErrorKind::Value, "target_ke");
  expect(revolute({.armature = -1.0f}), ErrorKind::Value, "armature");
  expect(revolute({.effort_limit = -1.0f}), ErrorKind::Value, "effort_limit");
  expect(revolute({.actuator_mode = static_cast<JointTargetMode>(5)}), ErrorKind::Value,
         "actuator_mode: expected a JointTargetMode");
  expect([&] { b.add_joint(JointType::REVOLUTE, 0, 6); }, ErrorKind::Value, "expected 0 and 1");
  expect([&] { b.add_joint(static_cast<JointType>(9), 0, 6); }, ErrorKind::Value, "JointType");
  expect(
      [&] {
        b.add_joint_d6(0, 6, {.angular_axes = {{}, {}}});
      },
      ErrorKind::Value, "linearly independent");
  expect(
      [&] {
        b.add_joint_fixed(0, 6, {.parent_xform = {{}, {0.0f, 0.0f, 0.0f, 0.0f}}});
      },
      ErrorKind::Value, "parent_xform");
  expect([&] { b.add_joint_distance(0, 6, {.min_distance = 2.0f, .max_distance = 1.0f}); },
         ErrorKind::Value, "shorter one first");
}

TEST(Joints, AnArticulationIsATreeWithParentsFirst) {
  ModelBuilder b;
  for (int k = 0; k < 4; ++k) b.add_link(link());
  b.add_joint_revolute(1, 2);   // 0: before its parent
  b.add_joint_revolute(-1, 1);  // 1
  b.add_joint_revolute(1, 2);   // 2
  b.add_joint_revolute(2, 3);   // 3
  b.add_joint_revolute(3, 1);   // 4: a second parent, and a cycle
  b.add_joint_revolute(-1, 0);  // 5
  const auto refused = [&](std::vector<int32_t> joints, const char* what) {
    EXPECT_ERROR(b.add_articulation(joints), ErrorKind::Value, what);
    EXPECT_EQ(b.articulation_count(), 0);
  };
  refused({}, "at least one");
  refused({0, 1}, "expected the root, with the parent -1");
  refused({1, 3}, "contiguous and increasing");
  refused({1, 2, 3, 4}, "expected a child that no other joint of an articulation has, got body 1");
  refused({4, 5}, "expected the root");
  EXPECT_ERROR(b.add_articulation(std::array{6}), ErrorKind::Index, "expected 0 to 5");
  EXPECT_EQ(b.add_articulation(std::array{1, 2, 3}), 0);
  EXPECT_ERROR(b.add_articulation(std::array{3}), ErrorKind::Value, "expected one of no articul");

  ModelBuilder cycle;  // 1 -> 2 -> 1
  for (int k = 0; k < 3; ++k) cycle.add_link(link());
  cycle.add_joint_revolute(-1, 0);
  cycle.add_joint_revolute(2, 1);
  cycle.add_joint_revolute(1, 2);
  EXPECT_ERROR(cycle.add_articulation(std::array{0, 1, 2}), ErrorKind::Value,
               "got body 2: parents come first, and a cycle has no such order");

  ModelBuilder kinematic;
  kinematic.add_link(link());
  kinematic.add_link({.is_kinematic = true});
  kinematic.add_joint_revolute(-1, 0);
  kinematic.add_joint_revolute(0, 1);
  EXPECT_ERROR(kinematic.add_articulation(std::array{0, 1}), ErrorKind::Value, "kinematic body 1");
}

TEST(Joints, EditedListsAreCheckedByFinalize) {
  const auto refused = [](auto&& edit, const char* what) {
    ModelBuilder b = chain();
    edit(b);
    EXPECT_ERROR(b.finalize(), ErrorKind::Value, what);
  };
  refused([](ModelBuilder& b) { b.joint_q[5] = 0.0f; }, "joint_q[2]: expected the first of four");
  refused([](ModelBuilder& b) { b.joint_q[0] = kNan; }, "joint_q[0]");
  refused([](ModelBuilder& b) { b.joint_q.pop_back(); }, "joint_q: expected 23");
  refused([](ModelBuilder& b) { b.joint_limit_lower[1] = 2e10f; }, "joint_limit_lower[1]");
  refused([](ModelBuilder& b) { b.joint_armature[1] = -1.0f; }, "joint_armature[1]");
  refused([](ModelBuilder& b) { b.joint_target_mode[0] = 7; }, "joint_target_mode[0]");
}

TEST(Joints, CollapsedFixedJointsKeepMassShapesAndFrames) {
  // base - fixed - tool (with a box) - fixed - tip; a hinge hangs on the tip.
  ModelBuilder b;
  b.add_link(link(2.0f));
  b.add_link({});
  b.add_link(link(0.5f));
  b.add_link(link());
  b.add_shape_box(1, {.xform = {{0.1f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f, 1.0f}}, .hx = 0.1f});
  b.add_shape_box(-1);
  b.add_joint_revolute(-1, 0);
  b.add_joint_fixed(0, 1, {.parent_xform = kTurned, .label = "tool"});
  b.add_joint_fixed(1, 2, {.child_xform = kTurned});
  b.add_joint_prismatic(2, 3);
  b.joint_q = {0.25f, 0.5f};
  b.add_articulation(std::array{0, 1, 2, 3});
  ModelBuilder kept = b;
  EXPECT_EQ(kept.collapse_fixed_joints(std::array{std::string("tool")}).joint_remap,
            (std::vector<int32_t>{0, 1, -1, 2}));
  const auto before = b.finalize();
  const CollapsedJoints done = b.collapse_fixed_joints();
  EXPECT_EQ(done.body_remap, (std::vector<int32_t>{0, -1, -1, 1}));
  EXPECT_EQ(done.joint_remap, (std::vector<int32_t>{0, -1, -1, 1}));
  EXPECT_EQ(done.body_merged_parent, (std::vector<int32_t>{-1, 0, 0, -1}));
  const auto m = b.finalize();
  EXPECT_EQ(m->joint_q.to_host(), (std::vector<float>{0.25f, 0.5f}));
  EXPECT_EQ(m->joint_parent.to_host(), (std::vector<int32_t>{-1, 0}));
  EXPECT_EQ(m->joint_ancestor.to_host(), (std::vector<int32_t>{-1, 0}));
  EXPECT_EQ(m->articulation_end.to_host(), (std::vector<int32_t>{2}));
  EXPECT_EQ(m->shape_body.to_host(), (std::vector<int32_t>{0, -1}));
  // tool at kTurned; tip at kTurned kTurned^-1, the origin.
  EXPECT_NEAR(math::length(m->joint_X_p.to_host()[1].p), 0.0f, 1e-6f);
  EXPECT_NEAR(math::length(m->shape_transform.to_host()[0].p - Vec3f{1.0f, 2.1f, 3.0f}), 0.0f,
              1e-6f);
  // The center of mass and the inertia of the three parts, about the origin of the base.
  const auto mass = before->body_mass.to_host();
  const double box = mass[1];
  EXPECT_NEAR(m->body_mass.to_host()[0], 2.5 + box, 1e-4);
  const double share = box / (2.5 + box);
  const Vec3f com = m->body_com.to_host()[0];
  EXPECT_NEAR(com.x, share * 1.0, 1e-5);
  EXPECT_NEAR(com.y, share * 2.1, 1e-5);
  EXPECT_NEAR(com.z, share * 3.0, 1e-5);
  // reduced mass of the two parts, about the common center
  const double reduced = 2.5 * box / (2.5 + box);
  const double own = box / 3.0 * (0.1 * 0.1 + 0.5 * 0.5);  // turned by 90 degrees about z
  EXPECT_NEAR(m->body_inertia.to_host()[0].m[2][2], 0.2 + own + reduced * (1.0 * 1.0 + 2.1 * 2.1),
              5e-3);
}

TEST(Joints, AFixedBaseCollapsesIntoTheWorld) {
  ModelBuilder b;
  b.add_link(link());
  b.add_link(link());
  b.add_shape_sphere(0);
  b.add_joint_fixed(-1, 0, {.parent_xform = kTurned});
  b.add_joint_revolute(0, 1);
  b.add_articulation(std::array{0, 1});
  b.collapse_fixed_joints();
  const auto m = b.finalize();
  EXPECT_EQ(m->body_count(), 1);
  EXPECT_EQ(m->shape_body.to_host()[0], -1);
  EXPECT_EQ(m->shape_transform.to_host()[0], kTurned);
  EXPECT_EQ(m->joint_parent.to_host()[0], -1);
  EXPECT_EQ(m->joint_X_p.to_host()[0], kTurned);
}

}  // namespace
}  // namespace novaphy
