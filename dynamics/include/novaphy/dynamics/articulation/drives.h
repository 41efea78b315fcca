// Drives, limits and damping of joints with one dof, and the damping of BALL joints.
//
// The force of a dof at q with the rate v, by its branch:
//   inside the limits   t = ke (q* - q) + kd (qd* - v), as far as the target mode has it
//   outside             t = limit_ke (limit - q) - limit_kd v, and no drive
// and always - damping v. Implicit (the default): q and v are those of the end of the step, which
// adds dt D + dt^2 K to the mass matrix, with the K and D of the branch; so a joint is stable
// whatever its gains. |t| of a drive beyond the effort limit becomes the limit, and a limit that
// would pull at the end of the step lets go; both are decided once, from a first solve.
// Explicit: t at the beginning of the step, and limits that pull, as Newton 1.8.
#pragma once

#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

// Rows are those of the tree's arrays; target_q has those of coordinates.
template <class T>
struct Drives {
  const int32_t* target_mode = nullptr;  // JointTargetMode
  const T *target_q = nullptr, *target_qd = nullptr, *target_ke = nullptr, *target_kd = nullptr,
          *damping = nullptr, *armature = nullptr, *limit_lower = nullptr, *limit_upper = nullptr,
          *limit_ke = nullptr, *limit_kd = nullptr, *effort_limit = nullptr,
          *velocity_limit = nullptr;
};

// What a dof did in a step.
enum Branch : int32_t {
  kBelowLimit = 1,
  kAboveLimit = 2,
  kLimitReleased = 4,   // with one of these two
  kEffortAtUpper = 8,   // the drive gave + effort_limit
  kEffortAtLower = 16,  // and - effort_limit
  kVelocityAtUpper = 32,
  kVelocityAtLower = 64,
};
inline constexpr int32_t kOutside = kBelowLimit | kAboveLimit;
inline constexpr int32_t kEffortClamped = kEffortAtUpper | kEffortAtLower;
inline constexpr int32_t kVelocityClamped = kVelocityAtUpper | kVelocityAtLower;

inline bool has_position_drive(int32_t mode) { return mode == 1 || mode == 3; }
inline bool has_velocity_drive(int32_t mode) { return mode >= 1 && mode <= 3; }
inline bool has_one_dof(const Link& link) {
  return link.joint == LinkJoint::Prismatic || link.joint == LinkJoint::Revolute;
}
// Which dofs of a link angular damping acts on.
inline bool is_angular(const Link& link, int32_t dof_of_link) {
  return link.joint == LinkJoint::Revolute || link.joint == LinkJoint::Ball ||
         (link.joint == LinkJoint::Free && dof_of_link >= 3);
}

// t = stiffness (target - q) + rate (target_rate - v): the law of a dof's branch.
template <class T>
struct DriveLaw {
  T stiffness{}, target{}, rate{}, target_rate{};
};
// `row` is the dof's, `coord` its coordinate's. Released limits have no law.
template <class T>
DriveLaw<T> drive_law(const Drives<T>& d, int32_t row, int32_t coord, const Branches<T>& branch) {
  const T o = T(0.0f);
  const int32_t mode = d.target_mode[row];
  const T ke = has_position_drive(mode) ? d.target_ke[row] : o;
  const T kd = has_velocity_drive(mode) ? d.target_kd[row] : o;
  const T qd = mode == 1 ? o : d.target_qd[row];
  if (!any(has(branch, kOutside))) return {ke, d.target_q[coord], kd, qd};
  const auto outside = has(branch, kOutside), released = has(branch, kLimitReleased);
  const T limit = select(has(branch, kBelowLimit), d.limit_lower[row], d.limit_upper[row]);
  return {select(released, o, select(outside, d.limit_ke[row], ke)),
          select(released, o, select(outside, limit, d.target_q[coord])),
          select(released, o, select(outside, d.limit_kd[row], kd)), select(outside, o, qd)};
}

// The branch that q is in. A limit without stiffness and damping is none.
template <class T>
Branches<T> limit_branch(const Drives<T>& d, int32_t row, const T& q) {
  const T o = T(0.0f);
  const auto acts = either(d.limit_ke[row] > o, d.limit_kd[row] > o);
  const auto below = both(acts, q < d.limit_lower[row]);
  const auto above = both(both(acts, negate(below)), q > d.limit_upper[row]);
  return with(with(Branches<T>{}, below, kBelowLimit), above, kAboveLimit);
}

// A force at the start of a step and how much of it an acceleration takes away.
template <class T>
struct DriveTerm {
  T force{}, diagonal{};
};
template <class T>
DriveTerm<T> drive_term(const DriveLaw<T>& law, const T& q, const T& v, const T& dt,
                        bool implicit) {
  const T force = law.stiffness * (law.target - q) + law.rate * (law.target_rate - v);
  if (!implicit) return {force, T(0.0f)};
  const T damped = dt * law.stiffness;
  return {force - damped * v, dt * (law.rate + damped)};
}

// The term of a dof of a joint with one, in its branch, damping included.
template <class T>
DriveTerm<T> dof_term(const Drives<T>& d, int32_t row, int32_t coord, const Branches<T>& branch,
                      const T& q, const T& v, const T& dt, bool implicit) {
  DriveTerm<T> term = drive_term(drive_law(d, row, coord, branch), q, v, dt, implicit);
  const auto clamped = has(branch, kEffortClamped);
  if (any(clamped)) {
    const T limit = d.effort_limit[row];
    term = {select(clamped, select(has(branch, kEffortAtUpper), limit, -limit), term.force),
            select(clamped, T(0.0f), term.diagonal)};
  }
  term.force = term.force - d.damping[row] * v;
  if (implicit) term.diagonal = term.diagonal + dt * d.damping[row];
  return term;
}

// What the drive or limit gives at the end of a step with the acceleration qdd, and the branch that
// follows from it.
template <class T>
Branches<T> clamped_branch(const Drives<T>& d, int32_t row, int32_t coord,
                           const Branches<T>& branch, const T& q, const T& v, const T& qdd,
                           const T& dt, bool implicit) {
  const DriveTerm<T> term = drive_term(drive_law(d, row, coord, branch), q, v, dt, implicit);
  const T o = T(0.0f), force = term.force - term.diagonal * qdd, limit = d.effort_limit[row];
  const auto outside = has(branch, kOutside), inside = negate(outside);
  Branches<T> next = branch;
  if (implicit && any(outside)) {
    const auto below = has(branch, kBelowLimit);
    const auto pulls = either(both(below, force < o), both(negate(below), force > o));
    next = with(next, both(outside, pulls), kLimitReleased);
  }
  next = with(next, both(inside, force > limit), kEffortAtUpper);
  return with(next, both(inside, force < -limit), kEffortAtLower);
}

}  // namespace novaphy::articulation
