// The list of the joint types of links, and the queries that the algorithms make about a link's
// joint.
//
// Each type has a header with a class that has these members:
//   kType, kLinear, kAngular      its LinkJoint, and its numbers of linear and angular dofs (linear
//                                 first)
//   kQuaternion                   the first coordinate of its quaternion; -1: none
//   kHasDrive                     whether the joint has one dof with a drive and limits
//   kIsFree, kIsKinematic         S moves with the center of mass; the rates are prescribed
//   transform                     X_j(q), with a normalized quaternion, and its length before
//   set_axes                      the columns of S of a link, from its frames
//   integrate, integrate_vjp      q after dt with the rates u, quaternions normalized; the adjoint
//   gradient_to_tangent           converts a gradient by the coordinates to one by the tangent
//   tangent_to_gradient           the inverse; put(coordinate of the joint, value)
// S may not depend on the joint's own q, except for kIsFree. In long chains (articulated_body.h)
// each column of S is a pure translation or a pure rotation.
#pragma once

#include "novaphy/dynamics/articulation/joints/ball.h"
#include "novaphy/dynamics/articulation/joints/fixed.h"
#include "novaphy/dynamics/articulation/joints/free.h"
#include "novaphy/dynamics/articulation/joints/prismatic.h"
#include "novaphy/dynamics/articulation/joints/revolute.h"

namespace novaphy::articulation {

template <class... Joint>
struct JointList {
  // Calls f(type) with the joint type of a link.
  template <class F>
  static void visit(LinkJoint type, const F& f) {
    (void)((type == Joint::kType && (f(Joint{}), true)) || ...);
  }
  // Returns question(joint) for a link's joint type. `question` reads a constant of the type.
  template <class Question>
  static bool ask(LinkJoint type, const Question& question) {
    return ((question(Joint{}) && type == Joint::kType) || ...);
  }
};
using Joints =
    JointList<PrismaticJoint, RevoluteJoint, BallJoint, FreeJoint, KinematicJoint, FixedJoint>;

inline bool is_kinematic(const Link& link) {
  return Joints::ask(link.joint, [](auto joint) { return decltype(joint)::kIsKinematic; });
}
inline bool is_free(const Link& link) {
  return Joints::ask(link.joint, [](auto joint) { return decltype(joint)::kIsFree; });
}
// Returns whether a link's joint has one dof with a drive and limits.
inline bool has_one_dof(const Link& link) {
  return Joints::ask(link.joint, [](auto joint) { return decltype(joint)::kHasDrive; });
}
inline bool is_ball(const Link& link) { return link.joint == BallJoint::kType; }
inline bool has_quaternion(const Link& link) {
  return Joints::ask(link.joint, [](auto joint) { return decltype(joint)::kQuaternion >= 0; });
}
inline int32_t coordinate_count(const Link& link) {
  return link.dofs + (has_quaternion(link) ? 1 : 0);
}
inline bool is_linear(const Link& link, int32_t dof_of_link) {
  return Joints::ask(link.joint,
                     [&](auto joint) { return dof_of_link < decltype(joint)::kLinear; });
}
// Returns whether angular damping acts on dof `dof_of_link` of a link.
inline bool is_angular(const Link& link, int32_t dof_of_link) {
  return Joints::ask(link.joint, [&](auto joint) {
    return !decltype(joint)::kIsKinematic && decltype(joint)::kAngular > 0 &&
           dof_of_link >= decltype(joint)::kLinear;
  });
}

}  // namespace novaphy::articulation
