// The joints of links: the list of their types, and what the algorithms ask of a link's joint.
//
// A type has, in a header of its own:
//   kType, kLinear, kAngular      its number, and its degrees of freedom, the linear ones first
//   kQuaternion                   the first coordinate of its quaternion; -1: none
//   kHasDrive                     one dof with a drive and limits
//   kIsFree, kIsKinematic         S moves with the center of mass; the rates are given
//   transform                     X_j(q), with a quaternion of any length made unit; its length
//   set_axes                      the columns of S of a link whose frames are set
//   integrate, integrate_vjp      q after dt at the rates u, quaternions made unit; its adjoint
//   gradient_to_tangent           from a gradient by the numbers of q to one by the tangent
//   tangent_to_gradient           the other way; put(coordinate of the joint, value)
// S may not depend on the joint's own q, but for kIsFree. In chains of many joints
// (articulated_body.h) each column is a translation or a turn.
#pragma once

#include "novaphy/dynamics/articulation/joints/ball.h"
#include "novaphy/dynamics/articulation/joints/fixed.h"
#include "novaphy/dynamics/articulation/joints/free.h"
#include "novaphy/dynamics/articulation/joints/prismatic.h"
#include "novaphy/dynamics/articulation/joints/revolute.h"

namespace novaphy::articulation {

template <class... Joint>
struct JointList {
  // f(type) of the type that a link has.
  template <class F>
  static void visit(LinkJoint type, const F& f) {
    (void)((type == Joint::kType && (f(Joint{}), true)) || ...);
  }
  // Whether `question`, a constant of a type, holds for the type that a link has.
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
// A drive and limits.
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
// Which dofs of a link angular damping acts on.
inline bool is_angular(const Link& link, int32_t dof_of_link) {
  return Joints::ask(link.joint, [&](auto joint) {
    return !decltype(joint)::kIsKinematic && decltype(joint)::kAngular > 0 &&
           dof_of_link >= decltype(joint)::kLinear;
  });
}

}  // namespace novaphy::articulation
