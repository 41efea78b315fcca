// Articulations with joints of all types. Drives, limits and clamps of all kinds are active.
#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing {

class AllJointsScene {
 public:
  // A floating one, and one on a rail, with bodies in another order than their joints.
  static ModelBuilder make() {
    AllJointsScene scene;
    scene.add_floating();
    scene.add_on_rail();
    scene.set_state();
    return std::move(scene.b_);
  }

 private:
  float number() { return unit_(random_); }
  Vec3f vector() { return {number(), number(), number()}; }
  Quatf rotation() {
    const Quatf q = {number(), number(), number(), 1.2f + number()};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {q.x / l, q.y / l, q.z / l, q.w / l};
  }
  Transformf pose() { return {vector() * 0.3f, rotation()}; }
  int32_t link() {
    return b_.add_link(
        {.com = vector() * 0.1f,
         .mass = 1.5f + number(),
         .inertia =
             Mat33f{{{0.05f, 0.004f, 0.0f}, {0.004f, 0.07f, -0.003f}, {0.0f, -0.003f, 0.06f}}}});
  }
  // Drives of all modes; some limits are passed at once, some clamps are low.
  JointDofConfig dof() {
    const int k = count_++;
    JointDofConfig d;
    d.axis = vector();
    d.target_q = number();
    d.target_qd = number();
    d.target_ke = 30.0f + 20.0f * number();
    d.target_kd = 2.0f + number();
    d.damping = 0.1f;
    d.armature = 0.02f;
    d.limit_lower = k % 3 == 1 ? 0.2f : -0.5f;
    d.limit_upper = d.limit_lower + 0.6f;
    d.limit_ke = 300.0f;
    d.limit_kd = 3.0f;
    d.effort_limit = k % 2 == 0 ? 4.0f : 1e6f;
    d.velocity_limit = k % 4 == 0 ? 0.7f : 50.0f;
    d.actuator_mode = static_cast<JointTargetMode>(k % 4);
    return d;
  }
  AxisJointArgs one() { return {.parent_xform = pose(), .child_xform = pose(), .dof = dof()}; }

  void add_floating() {
    const int32_t trunk = link(), hip = link(), slide = link(), shoulder = link(), hand = link(),
                  pod = link();
    b_.add_articulation(std::vector<int32_t>{
        b_.add_joint_free(trunk, {.child_xform = pose()}), b_.add_joint_revolute(trunk, hip, one()),
        b_.add_joint_prismatic(hip, slide, one()),
        b_.add_joint_ball(trunk, shoulder, {.parent_xform = pose(), .child_xform = pose()}),
        b_.add_joint_revolute(shoulder, hand, one()),
        b_.add_joint_free(pod, {.parent_xform = pose(), .child_xform = pose(), .parent = hip})});
  }
  void add_on_rail() {
    const int32_t tip = link(), wrist = link(), plate = link(), cart = link();
    JointArgs many = {.parent_xform = pose(), .child_xform = pose()};
    JointDofConfig axes[5];
    for (JointDofConfig& axis : axes) axis = dof();
    for (int k = 0; k < 5; ++k)
      axes[k].axis = {k % 3 == 0 ? 1.0f : 0.2f, k % 3 == 1 ? 1.0f : 0.1f,
                      k % 3 == 2 ? 1.0f : -0.3f};
    many.linear_axes = {axes[0], axes[1]};
    many.angular_axes = {axes[2], axes[3], axes[4]};
    b_.add_articulation(std::vector<int32_t>{
        b_.add_joint_prismatic(-1, cart, one()),
        b_.add_joint_fixed(cart, plate, {.parent_xform = pose(), .child_xform = pose()}),
        b_.add_joint_d6(plate, wrist, many), b_.add_joint_revolute(wrist, tip, one())});
  }
  void set_state() {
    const auto model = b_.finalize(Device::cpu());
    const std::vector<int32_t> start = model->joint_q_start.to_host(),
                               type = model->joint_type.to_host(),
                               dofs = model->joint_qd_start.to_host();
    for (float& v : b_.joint_qd) v = number();
    for (float& f : b_.joint_f) f = 2.0f * number();
    for (size_t j = 0; j < type.size(); ++j) {
      const bool ball = type[j] == static_cast<int32_t>(JointType::BALL),
                 turns = ball || type[j] == static_cast<int32_t>(JointType::FREE);
      auto c = static_cast<size_t>(start[j]);
      for (const size_t end = static_cast<size_t>(start[j + 1]) - (turns ? 4 : 0); c < end; ++c)
        b_.joint_q[c] += 0.4f * number();
      if (!turns) continue;
      const Quatf q = rotation();
      for (const float x : {q.x, q.y, q.z, q.w}) b_.joint_q[c++] = x;
      for (int32_t k = dofs[j]; ball && k < dofs[j + 1]; ++k)
        b_.joint_damping[static_cast<size_t>(k)] = 0.5f;
    }
  }

  ModelBuilder b_;
  std::mt19937 random_{11};
  std::uniform_real_distribution<float> unit_{-1.0f, 1.0f};
  int count_ = 0;
};

}  // namespace novaphy::testing
