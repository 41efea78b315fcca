// One step of a tree without contacts.
//
//   M = H(q) + diag(armature + terms of drives),  M qdd = f - bias(q, qd) + drives (drives.h) + r
//   v  = qd + dt qdd, |v| <= velocity_limit for joints with one dof. r is the force of a dof at its
//        velocity limit, which only acts inwards, and which the rest of the tree feels
//   q' = q moved by v over dt (quaternions by the Cayley map), plus shifts that correct overlaps
//        (pgs.h) and stay within the limits of joints
//   qd' = v, times 1 - angular_damping dt for angular dofs
//   q', qd' of mimic joints follow from their leaders (mimic.h); body_q, body_qd from (q', qd')
// Kinematic dofs have infinite inertia: their qdd is 0 for any force, without damping, and their
// descendants move with them. Contacts (pgs.h) change v after the first line; qdd then includes
// their effect. Wrenches on bodies, and joint_f of FREE joints, are world wrenches about the center
// of mass. All results except positions have the same bits at any position of the roots.
#pragma once

#include "novaphy/dynamics/articulation/ball_drives.h"
#include "novaphy/dynamics/articulation/factor.h"
#include "novaphy/dynamics/articulation/rate_bounds.h"

namespace novaphy::articulation {

template <class T>
void set_wrenches(const Tree<T>& tree, const StepInputs<T>& in, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    SpatialVector<T>& wrench = ws.links[i].wrench;
    wrench = link.body < 0 ? zero_spatial<T>() : in.body_f[link.body];
    if (!is_free(link)) continue;
    const T* f = in.joint_f + link.dof;
    wrench = wrench + SpatialVector<T>{{f[0], f[1], f[2]}, {f[3], f[4], f[5]}};
  }
}

// Calls f(link, k) for the one-dof joints, which have drives and limits. k: dof in the tree.
template <class T, class F>
void for_drives(const Tree<T>& tree, const F& f) {
  for (int32_t i = 0; i < tree.link_count; ++i)
    if (has_one_dof(tree.links[i])) f(tree.links[i], local_dof(tree, tree.links[i]));
}

// Returns a mask of the SIMD lanes (a tree each) in which any dof is at its velocity limit.
template <class T>
auto holds_rates(const Tree<T>& tree, const Workspace<T>& ws) {
  Branches<T> all{};
  for (int32_t k = 0; k < tree.dof_count; ++k) all = all | ws.branch[k];
  return has(all, kVelocityClamped);
}
// Sets the accelerations of dofs at a rate bound (rate_bounds.h), and of their mimic joints.
template <class T>
void hold_accelerations(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                        Workspace<T>& ws) {
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T v = in.qd[link.dof];
    const T to = held_rate(in, options, link.dof, link.coord, ws.branch[k]).rate;
    ws.qdd[k] = select(has(ws.branch[k], kVelocityClamped), (to - v) / options.dt, ws.qdd[k]);
  });
  spread_leaders(tree, ws.qdd);
}

// Computes rhs = joint_f - bias + drives, and the terms of armature and drives on M's diagonal.
// Dofs with prescribed accelerations get infinite inertia.
template <class T>
void add_drives(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                const T* bias, Workspace<T>& ws) {
  const T endless = T(math::bits_float(0x7f800000));
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    DriveTerm<T> of_ball[3];
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t row = link.dof + j;
      const int32_t k = row - tree.first_dof;
      DriveTerm<T> term{T(0.0f), T(0.0f)};
      if (has_one_dof(link)) {
        term = dof_term(in, row, link.coord, ws.branch[k], in.q[link.coord], in.qd[row], options.dt,
                        options.implicit_drives);
      } else if (is_ball(link)) {
        if (j == 0) ball_terms(link, in, options, ws.branch[k], of_ball, ws.cone + k);
        term = of_ball[j];
      }
      const T applied = is_free(link) ? T(0.0f) : in.joint_f[row];
      ws.rhs[k] = (applied - bias[k]) + term.force;
      T& diagonal = ws.diagonal[k];
      diagonal = is_kinematic(link) ? endless : in.armature[row] + term.diagonal;
      if (has_one_dof(link))
        diagonal = select(has(ws.branch[k], kVelocityClamped), endless, diagonal);
    }
  }
}

template <class T>
int32_t solve_accelerations(const Tree<T>& tree, const StepInputs<T>& in,
                            const StepOptions<T>& options, Workspace<T>& ws) {
  const auto holds = holds_rates(tree, ws);
  const T* bias = ws.bias;
  if (any(holds)) {
    for (int32_t k = 0; k < tree.dof_count; ++k) ws.qdd[k] = T(0.0f);
    hold_accelerations(tree, in, options, ws);
  }
  if (any(holds) && has_matrix(tree)) {  // forces that the prescribed accelerations need
    inverse_dynamics<T>(tree, in.qd + tree.first_dof, ws.qdd, ws, ws.rhs);
    for (int32_t k = 0; k < tree.dof_count; ++k) ws.rhs[k] = select(holds, ws.rhs[k], ws.bias[k]);
    bias = ws.rhs;
  }
  add_drives(tree, in, options, bias, ws);
  const int32_t failed = factor(tree, in.q, ws);
  if (failed >= 0) return failed;
  find_accelerations(tree, in.qd + tree.first_dof, ws);
  if (any(holds)) hold_accelerations(tree, in, options, ws);
  return -1;
}

// The forces of drives and limits of one-dof joints in a step with the acceleration qdd.
template <class T>
struct StepDrives {
  const StepInputs<T>& in;
  const StepOptions<T>& options;

  UnclippedForces<T> unclipped(const Link& link, const Branches<T>& branch, const T& qdd) const {
    return unclipped_forces(in, link.dof, link.coord, branch, in.q[link.coord], in.qd[link.dof],
                            qdd, options.dt, options.implicit_drives);
  }
  T given(const Link& link, const Branches<T>& branch, const T& qdd) const {
    return given_force(branch, unclipped(link, branch, qdd), in.effort_limit[link.dof],
                       options.implicit_drives);
  }
  // Returns the force of drive and limit that a solve with the given branch assumes.
  T assumed(const Link& link, const Branches<T>& branch, const T& qdd) const {
    const DriveTerm<T> term = branch_term(in, link.dof, link.coord, branch, in.q[link.coord],
                                          in.qd[link.dof], options.dt, options.implicit_drives);
    return term.force - term.diagonal * qdd;
  }
  Branches<T> next(const Link& link, const Branches<T>& branch, const T& qdd, bool keep) const {
    return next_branch(branch, unclipped(link, branch, qdd), in.effort_limit[link.dof],
                       options.implicit_drives, keep);
  }
};

// Line search. The forces t of drives and limits decrease with qdd, so the solution of M qdd = f -
// bias + t(qdd) minimizes a convex function. A solve with the branches of a point is a Newton step,
// and full Newton steps may cycle. So the best point so far (qdd in qd_next, t in `given`) moves
// towards the solution only as far as the function decreases. Its slope along p is p . (M qdd - f +
// bias - t).
template <class T>
T slope_towards(const Tree<T>& tree, const StepDrives<T>& drives, const Workspace<T>& ws,
                const T& s) {
  T sum = T(0.0f);
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T p = ws.qdd[k] - ws.qd_next[k], from = ws.given[k];
    const T force = from + s * (drives.assumed(link, ws.branch[k], ws.qdd[k]) - from);
    sum = sum + p * (force - drives.given(link, ws.branch[k], ws.qd_next[k] + s * p));
  });
  return sum;
}

inline constexpr int32_t kFreeRounds = 32;  // later rounds keep clamped drives clamped
inline constexpr int32_t kHalvings = 16;

// Computes the next round's branches. Returns false if all lanes fit the branches of the solve.
template <class T>
bool next_branches(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                   int32_t round, Workspace<T>& ws) {
  const StepDrives<T> drives{in, options};
  const bool keep = round >= kFreeRounds;
  const T o = T(0.0f), one = T(1.0f);
  auto changes = one < o;
  for_drives(tree, [&](const Link& link, int32_t k) {
    const Branches<T> next = drives.next(link, ws.branch[k], ws.qdd[k], keep);
    changes = either(changes, differ(next, ws.branch[k]));
  });
  if (!any(changes)) return false;
  T s = one;
  if (round > 0 && !keep) {
    const auto too_far = slope_towards(tree, drives, ws, one) > o;
    T low = o, high = one;
    for (int32_t i = 0; i < kHalvings && any(too_far); ++i) {
      const T middle = T(0.5f) * (low + high);
      const auto rises = slope_towards(tree, drives, ws, middle) > o;
      high = select(rises, middle, high);
      low = select(rises, low, middle);
    }
    s = select(too_far, high, one);
  }
  const auto whole = negate(s < one);
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T qdd = ws.qdd[k], given = drives.assumed(link, ws.branch[k], qdd);
    const bool first = round == 0;
    const T p = first ? o : s * (qdd - ws.qd_next[k]), more = first ? o : s * (given - ws.given[k]);
    ws.qd_next[k] = first ? qdd : select(whole, qdd, ws.qd_next[k] + p);
    ws.given[k] = first ? given : select(whole, given, ws.given[k] + more);
    const Branches<T> next = drives.next(link, ws.branch[k], ws.qd_next[k], keep);
    ws.branch[k] = select(changes, next, ws.branch[k]);
  });
  return true;
}

// Solves for qdd until the branches are consistent. Returns a failed dof or -1.
template <class T>
int32_t settle(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
               Workspace<T>& ws) {
  for (int32_t round = 0;; ++round) {
    const int32_t failed = solve_accelerations(tree, in, options, ws);
    if (failed >= 0 || !next_branches(tree, in, options, round, ws)) return failed;
  }
}

// After a solve, moves dofs beyond a rate bound to that bound. Releases dofs whose force r would
// pull outwards, unless `keep`. A dof with equal bounds stays: the sign of r selects the bound.
// Only changes `lanes`. Returns false if no dof changed. ws.given: impulses of contacts and dry
// friction on dofs at a bound (N s or N m s).
template <class T, class Mask>
bool next_held_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                     const Mask& lanes, bool keep, Workspace<T>& ws) {
  const T o = T(0.0f);
  const auto holds = holds_rates(tree, ws);
  if (any(holds)) {  // compute the bound's force r in rhs
    inverse_dynamics<T>(tree, in.qd + tree.first_dof, ws.qdd, ws, ws.rhs);
    for_drives(tree, [&](const Link& link, int32_t k) {
      const int32_t row = link.dof;
      const DriveTerm<T> term = dof_term(in, row, link.coord, ws.branch[k], in.q[link.coord],
                                         in.qd[row], options.dt, options.implicit_drives);
      const T inertial = ws.rhs[k] + (in.armature[row] + term.diagonal) * ws.qdd[k];
      ws.rhs[k] = (inertial - (in.joint_f[row] + term.force)) - ws.given[k] / options.dt;
    });
    gather_mimics(tree, ws.rhs);
  }
  bool changes = false;
  for_drives(tree, [&](const Link& link, int32_t k) {
    if (follows(link)) return;
    const T most = rate_bound(in, options, link.dof, link.coord, 1.0f).rate,
            least = rate_bound(in, options, link.dof, link.coord, -1.0f).rate;
    const T v = in.qd[link.dof] + options.dt * ws.qdd[k];
    const Branches<T> branch = ws.branch[k];
    const auto held = has(branch, kVelocityClamped), over = v > most, under = v < least;
    if (!any(either(held, either(over, under)))) return;
    auto upper = has(branch, kVelocityAtUpper), lower = has(branch, kVelocityAtLower);
    if (any(held) && !keep) {
      const auto still = both(held, negate(most > least));
      const auto from_upper = both(upper, ws.rhs[k] > o), from_lower = both(lower, ws.rhs[k] < o);
      upper = either(both(upper, negate(from_upper)), both(from_lower, still));
      lower = either(both(lower, negate(from_lower)), both(from_upper, still));
    }
    upper = either(upper, both(negate(held), over));
    lower = either(lower, both(negate(held), under));
    ws.branch[k] = select(
        lanes, bound_branch(in, options, link.dof, link.coord, branch, upper, lower), branch);
    changes = changes || any(differ(ws.branch[k], branch));
  });
  return changes;
}

// Computes the new rates v = qd + dt qdd in ws.qd_next.
template <class T>
void free_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                Workspace<T>& ws) {
  for (int32_t k = 0; k < tree.dof_count; ++k)
    ws.qd_next[k] = in.qd[tree.first_dof + k] + options.dt * ws.qdd[k];
  if (!any(holds_rates(tree, ws))) return;
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T to = held_rate(in, options, link.dof, link.coord, ws.branch[k]).rate;
    ws.qd_next[k] = select(has(ws.branch[k], kVelocityClamped), to, ws.qd_next[k]);
  });
}

// Prepares the workspace for a step. Returns the first dof whose coordinate is not finite, counted
// from the tree's first dof; -1: none.
template <class T>
int32_t begin_step(const Tree<T>& tree, const StepInputs<T>& in, Workspace<T>& ws) {
  // Accelerations do not depend on the position of a tree, so coordinates are checked separately.
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    for (int32_t c = 0; c < coordinate_count(link); ++c)
      if (!is_finite(in.q[link.coord + c]))
        return local_dof(tree, link) + (c < link.dofs ? c : link.dofs - 1);
  }
  kinematics(tree, in.q, ws);
  set_wrenches(tree, in, ws);
  bias_forces(tree, in.qd + tree.first_dof, ws);
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.branch[k] = {};
  return -1;
}
// Returns whether x^2 is finite. Coordinates and body_qd use squares of rates and accelerations.
template <class T>
auto has_finite_square(const T& x) {
  return is_finite(x * x);
}
template <class T>
int32_t find_infinite(const Tree<T>& tree, const Workspace<T>& ws) {
  for (int32_t k = 0; k < tree.dof_count; ++k)
    if (!has_finite_square(ws.qdd[k])) return k;
  return -1;
}

// Repeats the solve until no dof changes at its velocity limits, in lanes of the mask `lanes`.
template <class T, class Mask>
int32_t hold_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                   const Mask& lanes, Workspace<T>& ws) {
  for (int32_t round = 0;; ++round) {
    for (int32_t k = 0; k < tree.dof_count; ++k) ws.given[k] = T(0.0f);
    if (!next_held_rates(tree, in, options, lanes, round >= kFreeRounds, ws)) return -1;
    const int32_t failed = settle(tree, in, options, ws);
    if (failed >= 0) return failed;
  }
}

// Computes qdd, branches and M's factor in the workspace. Returns a dof whose pivot is not positive
// or whose acceleration is not finite (in any lane), counted from the tree's first; -1: none.
// Velocity limits act in lanes that are `alone`. In other lanes they act after contacts, which may
// push dofs off their limits (renew_branches). Dofs with the limit 0 are at it from the first solve
// on, so they need no inertia.
template <class T, class Mask>
int32_t accelerate(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                   const Mask& alone, Workspace<T>& ws) {
  int32_t failed = begin_step(tree, in, ws);
  if (failed >= 0) return failed;
  for_drives(tree, [&](const Link& link, int32_t k) {
    ws.branch[k] =
        options.limit_rows ? Branches<T>{} : limit_branch(in, link.dof, in.q[link.coord]);
    if (follows(link)) return;
    const auto still = negate(rate_bound(in, options, link.dof, link.coord, 1.0f).rate >
                              rate_bound(in, options, link.dof, link.coord, -1.0f).rate);
    if (!any(still)) return;
    const auto lower = both(still, negate(still));
    ws.branch[k] = bound_branch(in, options, link.dof, link.coord, ws.branch[k], still, lower);
  });
  set_ball_branches(tree, in, options, ws);
  failed = settle(tree, in, options, ws);
  if (failed < 0) failed = hold_rates(tree, in, options, alone, ws);
  return failed >= 0 ? failed : find_infinite(tree, ws);
}

// Runs accelerate with the branches of an earlier step, indexed by dof of the model.
template <class T>
int32_t accelerate_again(const Tree<T>& tree, const StepInputs<T>& in,
                         const StepOptions<T>& options, const float* branch, Workspace<T>& ws) {
  int32_t failed = begin_step(tree, in, ws);
  if (failed >= 0) return failed;
  for (int32_t k = 0; k < tree.dof_count; ++k)
    ws.branch[k] = to_branches(branch[tree.first_dof + k]);
  failed = solve_accelerations(tree, in, options, ws);
  return failed >= 0 ? failed : find_infinite(tree, ws);
}

inline constexpr int32_t kContactRounds = 8;

// Updates the branches of effort and velocity limits from the accelerations after contacts, in
// lanes of the mask `lanes`. The release of position limits stays as without contacts. Returns true
// if solve_accelerations and contacts must run again. ws.given: as for next_held_rates.
template <class T, class Mask>
bool renew_branches(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                    const Mask& lanes, int32_t round, Workspace<T>& ws) {
  const StepDrives<T> drives{in, options};
  const bool keep = round >= kContactRounds;
  bool changes = next_held_rates(tree, in, options, lanes, keep, ws);
  for_drives(tree, [&](const Link& link, int32_t k) {
    const Branches<T> branch = ws.branch[k], next = drives.next(link, branch, ws.qdd[k], keep);
    ws.branch[k] = select(lanes, (next & ~kLimitReleased) | (branch & kLimitReleased), branch);
    changes = changes || any(differ(ws.branch[k], branch));
  });
  return changes;
}

// Computes the accelerations, and the new rates before angular damping.
template <class T>
int32_t forward_step(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                     Workspace<T>& ws) {
  const int32_t failed = accelerate(tree, in, options, T(0.0f) < T(1.0f), ws);
  if (failed < 0) free_rates(tree, in, options, ws);
  return failed;
}

// Returns the part of a dof's shift (pgs.h) that, with the rate v, moves the dof neither out of its
// limits nor farther out.
template <class T>
T kept_shift(const Link& link, const StepInputs<T>& in, const StepOptions<T>& options, const T& v,
             const T& shift) {
  const T o = T(0.0f), q = in.q[link.coord] + options.dt * v;
  const T up = (in.limit_upper[link.dof] - q) / options.dt;
  const T down = (in.limit_lower[link.dof] - q) / options.dt;
  const T most = select(up > o, up, o), least = select(down < o, down, o);
  return select(shift > most, most, select(shift < least, least, shift));
}
// Returns the rates that move the coordinates: new rates plus contact shifts within the limits.
template <class T>
const T* moving_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                      Workspace<T>& ws) {
  if (ws.shift == nullptr) return ws.qd_next;
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.rhs[k] = ws.qd_next[k] + ws.shift[k];
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T v = ws.qd_next[k];
    ws.rhs[k] = v + kept_shift(link, in, options, v, ws.shift[k]);
  });
  return ws.rhs;
}

// Returns the first dof whose new rate or shift is not finite (in any lane); -1: none.
template <class T>
int32_t first_not_finite(const Workspace<T>& ws, int32_t dofs) {
  for (int32_t k = 0; k < dofs; ++k)
    if (!has_finite_square(ws.qd_next[k]) || !has_finite_square(ws.shift[k])) return k;
  return -1;
}

// Writes the new state to the tree's rows of the arrays, after forward_step. Overwrites ws.links.
template <class T>
void finish_step(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                 Workspace<T>& ws, T* q_next, T* qd_next, Transform<T>* body_q,
                 SpatialVector<T>* body_qd) {
  integrate_coordinates(tree, in.q, moving_rates(tree, in, options, ws), options.dt, q_next);
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    for (int32_t j = 0; j < link.dofs; ++j)
      qd_next[link.dof + j] =
          ws.qd_next[local_dof(tree, link) + j] * damping_factor(link, j, options);
  }
  follow(tree, q_next, qd_next);
  link_frames(tree, q_next, ws);
  link_motions(tree, qd_next + tree.first_dof, ws);
  write_bodies(tree, ws, body_q, body_qd);
}

}  // namespace novaphy::articulation
