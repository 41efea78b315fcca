// Drives and damping of joints with one dof, together with their limits (limits.h). ball_drives.h
// has the drives of BALL joints.
//
// The force on a dof with position q and rate v:
//   drive      t = ke (q* - q) + kd (qd* - v) by the target mode, |t| <= effort_limit
//   limit      if q is outside: the law of limits.h, which pushes inwards only
//   damping    t = -damping v
// Implicit (the default): q and v are those at the end of the step. The mass matrix then gets dt D
// + dt^2 K, with the damping D and the stiffness K of the branch. A drive at its effort limit, and
// a limit that would pull, have K = D = 0. The branches that a solve assumes are consistent with
// its solution (step.h).
//
// Explicit: q and v are those at the start of the step, limits may pull, and drives do not act
// outside of the limits, as in Newton 1.8.
#pragma once

#include "novaphy/dynamics/articulation/joints/joints.h"
#include "novaphy/dynamics/articulation/limits.h"

namespace novaphy::articulation {

inline bool has_position_drive(int32_t mode) { return mode == 1 || mode == 3; }
inline bool has_velocity_drive(int32_t mode) { return mode >= 1 && mode <= 3; }
template <class T>
T damping_factor(const Link& link, int32_t dof_of_link, const StepOptions<T>& options) {
  return is_angular(link, dof_of_link) ? T(1.0f) - options.angular_damping * options.dt : T(1.0f);
}

// Returns the law of a drive. `row`: the dof, `coord`: its coordinate, both as indices of the
// model's arrays.
template <class T>
DriveLaw<T> drive_law(const StepInputs<T>& in, int32_t row, int32_t coord,
                      const Branches<T>& branch, bool implicit) {
  const T o = T(0.0f);
  const int32_t mode = in.target_mode[row];
  const T ke = has_position_drive(mode) ? in.target_ke[row] : o;
  const T kd = has_velocity_drive(mode) ? in.target_kd[row] : o;
  const T qd = mode == 1 ? o : in.target_qd[row];
  if (implicit || !any(has(branch, kOutside))) return {ke, in.target_q[coord], kd, qd};
  const auto outside = has(branch, kOutside);
  return {select(outside, o, ke), in.target_q[coord], select(outside, o, kd), qd};
}

// A dof's force for the acceleration 0, and minus the force's derivative by the acceleration.
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

// Returns the terms of the drive and the limit of a one-dof joint, in the given branch.
template <class T>
DriveTerm<T> branch_term(const StepInputs<T>& in, int32_t row, int32_t coord,
                         const Branches<T>& branch, const T& q, const T& v, const T& dt,
                         bool implicit) {
  DriveTerm<T> term = drive_term(drive_law(in, row, coord, branch, implicit), q, v, dt, implicit);
  const auto clamped = has(branch, kEffortClamped), limits = limit_acts<T>(branch);
  if (any(clamped)) {
    const T limit = in.effort_limit[row];
    term = {select(clamped, select(has(branch, kEffortAtUpper), limit, -limit), term.force),
            select(clamped, T(0.0f), term.diagonal)};
  }
  if (!any(limits)) return term;
  const DriveTerm<T> stop = drive_term(limit_law(in, row, branch), q, v, dt, implicit);
  return {select(limits, term.force + stop.force, term.force),
          select(limits, term.diagonal + stop.diagonal, term.diagonal)};
}

// Returns the terms of the drive, the limit and the damping of a one-dof joint.
template <class T>
DriveTerm<T> dof_term(const StepInputs<T>& in, int32_t row, int32_t coord,
                      const Branches<T>& branch, const T& q, const T& v, const T& dt,
                      bool implicit) {
  DriveTerm<T> term = branch_term(in, row, coord, branch, q, v, dt, implicit);
  term.force = term.force - in.damping[row] * v;
  if (implicit) term.diagonal = term.diagonal + dt * in.damping[row];
  return term;
}

// The forces of a dof's drive and limit in a step with the acceleration qdd, before clipping.
template <class T>
struct UnclippedForces {
  T drive{}, stop{};
};
template <class T>
UnclippedForces<T> unclipped_forces(const StepInputs<T>& in, int32_t row, int32_t coord,
                                    const Branches<T>& branch, const T& q, const T& v, const T& qdd,
                                    const T& dt, bool implicit) {
  const T o = T(0.0f);
  const DriveTerm<T> drive =
      drive_term(drive_law(in, row, coord, branch, implicit), q, v, dt, implicit);
  UnclippedForces<T> unclipped{drive.force - drive.diagonal * qdd, o};
  const auto outside = has(branch, kOutside);
  if (!any(outside)) return unclipped;
  const DriveTerm<T> stop = drive_term(limit_law(in, row, branch), q, v, dt, implicit);
  unclipped.stop = select(outside, stop.force - stop.diagonal * qdd, o);
  return unclipped;
}
// Returns the force of the drive, clipped to its effort limit, plus that of the limit. Implicit: a
// limit that would pull has no force.
template <class T>
T given_force(const Branches<T>& branch, const UnclippedForces<T>& unclipped, const T& effort_limit,
              bool implicit) {
  const T limit = effort_limit, drive = unclipped.drive;
  const T given = select(drive > limit, limit, select(drive < -limit, -limit, drive));
  if (!implicit) return given + unclipped.stop;
  return given + select(limit_pulls<T>(branch, unclipped.stop), T(0.0f), unclipped.stop);
}
// Returns the branch that matches the unclipped forces. `keep`: a drive or limit that does not act
// in `branch` stays inactive.
template <class T>
Branches<T> next_branch(const Branches<T>& branch, const UnclippedForces<T>& unclipped,
                        const T& effort_limit, bool implicit, bool keep) {
  auto upper = unclipped.drive > effort_limit, lower = unclipped.drive < -effort_limit;
  auto released = limit_pulls<T>(branch, unclipped.stop);
  if (keep) {
    const auto was_upper = has(branch, kEffortAtUpper), was_lower = has(branch, kEffortAtLower);
    upper = either(was_upper, both(upper, negate(was_lower)));
    lower = either(was_lower, both(lower, negate(was_upper)));
    released = either(released, has(branch, kLimitReleased));
  }
  Branches<T> next = branch & (kOutside | kVelocityClamped | kAtStop | kStopBounces);
  if (implicit) next = with(next, released, kLimitReleased);
  return with(with(next, upper, kEffortAtUpper), lower, kEffortAtLower);
}

// Adds the gradients by a dof's drive, limits and damping, and their contributions to q and qd.
// `turn`: the rotation phi of a BALL dof to its target (ball_drives.h), with the dof's position
// taken as 0; null for other joints. `diagonal`: gradient by M's diagonal from sources other than
// lambda qdd. `at_upper`, `at_lower`: AdjointMemory::stops (step_vjp.h).
template <class T>
void drive_gradient(const Link& link, int32_t dof_of_link, const StepInputs<T>& in,
                    const StepOptions<T>& options, const Branches<T>& branch, const T* turn,
                    const T& qdd, const T& lambda, const T& diagonal, const T& at_upper,
                    const T& at_lower, T& q_gradient, T& qd_gradient, const StepGradient<T>& g) {
  using G = StepGradient<T>;
  const int32_t row = link.dof + dof_of_link, mode = in.target_mode[row];
  const T o = T(0.0f), v = in.qd[row], dt = options.implicit_drives ? options.dt : o;
  const bool one = has_one_dof(link), driven = one || turn != nullptr;
  const auto outside = has(branch, kOutside), clamped = has(branch, kEffortClamped);
  auto drives = negate(clamped);
  if (!options.implicit_drives) drives = both(drives, negate(outside));
  const auto limits = limit_acts<T>(branch);
  DriveLaw<T> drive{o, o, o, o}, stop{o, o, o, o};
  if (driven) {
    drive = drive_law(in, row, link.coord, branch, options.implicit_drives);
    if (turn != nullptr) drive.target = *turn;
    drive.stiffness = select(drives, drive.stiffness, o);
    drive.rate = select(drives, drive.rate, o);
  }
  if (one) {
    stop = limit_law(in, row, branch);
    stop.stiffness = select(limits, stop.stiffness, o);
    stop.rate = select(limits, stop.rate, o);
  }
  const T stiffness = drive.stiffness + stop.stiffness, by_v = drive.rate + stop.rate;
  const T q = one ? in.q[link.coord] : o, damping = driven ? in.damping[row] : o;
  const T v_end = v + dt * qdd, q_end = q + dt * v_end;
  q_gradient = q_gradient - stiffness * lambda;
  qd_gradient = qd_gradient - ((by_v + damping) + dt * stiffness) * lambda;
  const bool position = driven && has_position_drive(mode);
  const bool velocity = driven && has_velocity_drive(mode);
  const auto of = [&](bool there, const auto& mask, const T& x) {
    return there ? select(mask, x, o) : o;
  };
  if (one) put(g, &G::target_q, link.coord, of(position, drives, drive.stiffness * lambda));
  put(g, &G::target_qd, row, of(velocity && mode != 1, drives, drive.rate * lambda));
  const T by_kd = dt * diagonal, by_ke = dt * by_kd;
  put(g, &G::target_ke, row, of(position, drives, (drive.target - q_end) * lambda - by_ke));
  put(g, &G::target_kd, row, of(velocity, drives, (drive.target_rate - v_end) * lambda - by_kd));
  put(g, &G::damping, row, driven ? -(v_end * lambda) - by_kd : o);
  put(g, &G::armature, row, -(lambda * qdd) - diagonal);
  const DriveGradient<T> of_limit = {lambda, q_end, v_end, by_ke, by_kd};
  limit_gradient(stop, row, one ? branch : Branches<T>{}, of_limit, at_upper, at_lower, g);
  const T by_effort = select(has(branch, kEffortAtUpper), lambda, -lambda);
  put(g, &G::effort_limit, row, of(one, clamped, by_effort));
}

}  // namespace novaphy::articulation
