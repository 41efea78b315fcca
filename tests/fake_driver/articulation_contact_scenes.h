// Scenes of articulations in contact, for tests on devices.
#pragma once

#include <vector>

#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing::contact_scenes {

inline constexpr float kDt = 1.0f / 240.0f;
inline const ShapeConfig kSurface = {.mu = 0.6f};

inline Transformf at(float x, float y, float z) { return {{x, y, z}, Quatf::identity()}; }

inline void add_box(ModelBuilder& b, const Vec3f& place, float size, const ShapeConfig& surface,
                    const SpatialVectorf& qd = {}) {
  const int32_t body = b.add_body({.xform = {place, {0.0f, 0.0998334f, 0.0f, 0.9950042f}}});
  b.add_shape_box(body, {.hx = size, .hy = size, .hz = size, .cfg = surface});
  const size_t first = b.joint_qd.size() - 6;
  const float v[6] = {qd.linear.x,  qd.linear.y,  qd.linear.z,
                      qd.angular.x, qd.angular.y, qd.angular.z};
  for (size_t k = 0; k < 6; ++k) b.joint_qd[first + k] = v[k];
}

// Boxes that land, slide, roll and bounce on a plane, apart from each other. The materials of some
// mix as in MuJoCo, by the larger friction, by weight, by priority, and with one without friction.
inline ModelBuilder boxes() {
  ModelBuilder b;
  b.add_ground_plane(
      {.cfg = ShapeConfig{.mu = 0.6f, .mixing = {.priority = 1.0f, .weight = 1.0f}}});
  for (int k = 0; k < 5; ++k) {
    const auto x = static_cast<float>(k);
    add_box(b, {x, 0.1f * x, 0.13f}, 0.1f,
            {.mu = 0.2f * x,
             .restitution = k % 2 == 0 ? 0.0f : 0.5f,
             .mixing = {.priority = 0.5f * x,
                        .weight = k < 4 ? 0.5f : 0.0f,
                        .inverse_mass = 0.2f,
                        .mu = 0.3f}},
            {{0.5f * x, 0.3f, -0.5f * x}, {x, 0.2f, -0.1f}});
  }
  return b;
}

// A stack of cubes, and a cube that flies into the stack.
inline ModelBuilder stack() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  for (int k = 0; k < 4; ++k) {
    const auto z = static_cast<float>(k);
    const int32_t body =
        b.add_body({.xform = at(0.003f * (k % 2 == 0 ? 1.0f : -1.0f), 0.0f, 0.1f + 0.2f * z)});
    b.add_shape_box(body, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
  }
  add_box(b, {-0.5f, 0.02f, 0.5f}, 0.08f, kSurface, {{6.0f, 0.0f, 1.0f}, {0.0f, 3.0f, 0.0f}});
  return b;
}

// A ball with four legs, one hinge each. `group` -1: the walker meets only the ground.
inline void add_walker(ModelBuilder& b, float x, float z, int32_t group, float friction) {
  const ShapeConfig surface = {.mu = 0.75f, .collision_group = group};
  const int32_t torso = b.add_link({.xform = at(x, 0.0f, z)});
  b.add_shape_sphere(torso, {.radius = 0.15f, .cfg = surface});
  std::vector<int32_t> joints = {b.add_joint_free(torso)};
  for (int k = 0; k < 4; ++k) {
    const float c = k < 2 ? 0.2f : -0.2f, s = k % 2 == 0 ? 0.2f : -0.2f;
    const int32_t leg = b.add_link();
    b.add_shape_capsule(leg, {.radius = 0.05f, .half_height = 0.12f, .cfg = surface});
    const JointDofConfig dof = {.axis = {-s, c, 0.0f},
                                .limit_lower = -0.6f,
                                .limit_upper = 0.6f,
                                .limit_ke = 1e3f,
                                .target_q = 0.2f,
                                .target_ke = 20.0f,
                                .damping = 0.5f,
                                .armature = 0.02f,
                                .friction = friction};
    joints.push_back(b.add_joint_revolute(
        torso, leg,
        {.parent_xform = at(c, s, 0.0f), .child_xform = at(0.0f, 0.0f, 0.15f), .dof = dof}));
  }
  b.add_articulation(joints);
}
// A walker that stands and kicks until its hinges are at their limits.
inline ModelBuilder kicking() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  add_walker(b, 0.0f, 0.318f, -1, 0.0f);
  for (size_t k = 6; k < b.joint_qd.size(); ++k) b.joint_qd[k] = k % 2 == 0 ? 40.0f : -25.0f;
  return b;
}
inline ModelBuilder walker() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  add_walker(b, 0.0f, 0.33f, -1, 0.0f);
  return b;
}

// Three worlds, each with one tree: slabs at fixed joints, whose corners make 12 contacts with the
// plane, more than kCoupledContacts. The trees of two worlds have an overlap to correct.
inline ModelBuilder slabs() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  for (int w = 0; w < 3; ++w) {
    ModelBuilder one;
    const int32_t middle =
        one.add_link({.xform = at(0.0f, 0.0f, 0.1f - 0.01f * static_cast<float>(w))});
    one.add_shape_box(middle, {.hx = 0.2f, .hy = 0.2f, .hz = 0.1f, .cfg = kSurface});
    std::vector<int32_t> joints = {one.add_joint_free(middle)};
    for (const float side : {-1.0f, 1.0f}) {
      const int32_t slab = one.add_link();
      one.add_shape_box(slab, {.hx = 0.2f, .hy = 0.2f, .hz = 0.1f, .cfg = kSurface});
      const JointDofConfig hinge = {
          .axis = {0.0f, 1.0f, 0.0f}, .limit_lower = -0.4f, .limit_upper = 0.4f};
      joints.push_back(one.add_joint_revolute(middle, slab,
                                              {.parent_xform = at(0.25f * side, 0.0f, 0.0f),
                                               .child_xform = at(-0.25f * side, 0.0f, 0.0f),
                                               .dof = hinge}));
    }
    one.add_articulation(joints);
    b.add_world(one);
    b.joint_qd[b.joint_qd.size() - 8] = 0.5f * static_cast<float>(w);
  }
  return b;
}

// Two walkers on each other and among boxes, whose legs meet everything. All form one island of
// trees and free bodies, with dry friction. An arm on the world reaches into the island.
inline ModelBuilder crowd() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  add_walker(b, 0.0f, 0.33f, 1, 0.3f);
  add_walker(b, 0.1f, 0.75f, 1, 0.0f);
  add_box(b, {0.35f, 0.0f, 0.12f}, 0.1f, kSurface, {{-1.0f, 0.0f, 0.0f}, {}});
  add_box(b, {-0.4f, 0.05f, 0.12f}, 0.1f, kSurface, {{1.5f, 0.0f, 0.0f}, {}});
  const int32_t arm = b.add_link();
  b.add_shape_capsule(arm, {.radius = 0.05f, .half_height = 0.3f, .cfg = kSurface});
  const JointDofConfig hinge = {.axis = {0.0f, 1.0f, 0.0f}, .friction = 2.0f};
  b.add_articulation(std::vector<int32_t>{b.add_joint_revolute(
      -1, arm,
      {.parent_xform = at(0.8f, 0.0f, 0.5f), .child_xform = at(0.0f, 0.0f, 0.35f), .dof = hinge})});
  return b;
}

// A kinematic slab that moves and rotates, with a walker and boxes on it. Another body is fixed to
// the world.
inline ModelBuilder turntable() {
  ModelBuilder b;
  const int32_t slab = b.add_body({.xform = at(0.0f, 0.0f, -0.1f), .is_kinematic = true});
  b.add_shape_box(slab, {.hx = 2.0f, .hy = 2.0f, .hz = 0.1f, .cfg = kSurface});
  b.body_qd[static_cast<size_t>(slab)] = {{0.4f, 0.1f, 0.05f}, {0.0f, 0.02f, 0.5f}};
  add_walker(b, 0.0f, 0.33f, 1, 0.3f);
  add_box(b, {0.6f, 0.1f, 0.13f}, 0.1f, kSurface, {{1.0f, 0.0f, -0.5f}, {}});
  add_box(b, {-0.7f, 0.4f, 0.13f}, 0.1f, kSurface);
  const int32_t post = b.add_link();
  b.add_shape_box(post, {.hx = 0.05f, .hy = 0.5f, .hz = 0.2f, .cfg = kSurface});
  b.add_articulation(
      std::vector<int32_t>{b.add_joint_fixed(-1, post, {.parent_xform = at(0.8f, 0.0f, 0.25f)})});
  return b;
}

// Snakes of more hinges in a row than the mass matrix takes, one with dry friction, whose heads are
// in the ground. Drives are at their effort limits, and hinges at their velocity limits.
inline void add_snake(ModelBuilder& b, float y, float friction) {
  const ShapeConfig surface = {.mu = 0.75f, .collision_group = -1};
  const int32_t head = b.add_link({.xform = at(0.0f, y, 0.072f)});
  b.add_shape_sphere(head, {.radius = 0.08f, .cfg = surface});
  std::vector<int32_t> joints = {b.add_joint_free(head)};
  for (int32_t k = 0, parent = head; k < 12; ++k) {
    const int32_t link = b.add_link();
    b.add_shape_sphere(link, {.radius = 0.07f, .cfg = surface});
    const JointDofConfig hinge = {
        .axis = {0.0f, k % 2 == 0 ? 1.0f : 0.0f, k % 2 == 0 ? 0.0f : 1.0f},
        .limit_lower = -0.3f,
        .limit_upper = 0.3f,
        .limit_ke = 50.0f,
        .limit_kd = 0.5f,
        .target_q = k % 3 == 0 ? 0.5f : -0.2f,
        .target_ke = 40.0f,
        .target_kd = 0.5f,
        .effort_limit = 2.0f,
        .velocity_limit = k % 4 == 0 ? 0.5f : 8.0f,
        .friction = k % 5 == 0 ? friction : 0.0f};
    joints.push_back(b.add_joint_revolute(
        parent, link, {.parent_xform = at(k == 0 ? 0.1f : 0.08f, 0.0f, 0.0f), .dof = hinge}));
    parent = link;
  }
  b.add_articulation(joints);
  b.joint_q[b.joint_q.size() - 12] = 0.05f;
  for (size_t k = b.joint_qd.size() - 12; k < b.joint_qd.size(); ++k)
    b.joint_qd[k] = k % 4 == 0 ? 0.45f : -0.2f;
}
inline ModelBuilder snakes() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  add_snake(b, 0.0f, 0.0f);
  add_snake(b, 1.0f, 0.05f);
  return b;
}

}  // namespace novaphy::testing::contact_scenes
