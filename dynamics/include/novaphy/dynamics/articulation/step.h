// One step of a tree without contact.
//
//   M = H(q) + diag(armature + what drives add),  M qdd = f - bias(q, qd) + drives (drives.h)
//   v  = qd + dt qdd, clamped to the velocity limits of joints with one dof
//   q' = q moved by v over dt (quaternions by the Cayley map), then qd' = v, of angular dofs
//   times 1 - angular_damping dt
//   q' and qd' of joints that follow others from theirs (mimic.h); body_q, body_qd of (q', qd')
// Kinematic dofs have endless inertia: their qdd is 0, whatever pulls at them, nothing damps them,
// and what hangs on them moves as they do. Contacts (pgs.h) change v between the first and the
// second line; qdd is then what they leave. Wrenches on bodies, and joint_f of FREE joints, are
// world wrenches about the centre of mass. All but where the roots are has the same bits wherever
// the roots are.
#pragma once

#include "novaphy/dynamics/articulation/drives.h"
#include "novaphy/dynamics/articulation/factor.h"

namespace novaphy::articulation {

template <class T>
struct StepOptions {
  T dt{};               // s
  T angular_damping{};  // 1/s
  bool implicit_drives = true;
};

// What acts and moves; rows of the arrays.
template <class T>
struct StepInputs {
  const T *q = nullptr, *qd = nullptr;
  const T* joint_f = nullptr;
  const SpatialVector<T>* body_f = nullptr;
  Drives<T> drives = {};
};

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

// rhs = joint_f - bias + drives, and what armature and drives add to M's diagonal.
template <class T>
void add_drives(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                Workspace<T>& ws) {
  const Drives<T>& d = in.drives;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t row = link.dof + j;
      const int32_t k = row - tree.first_dof;
      DriveTerm<T> term{T(0.0f), T(0.0f)};
      if (has_one_dof(link)) {
        term = dof_term(d, row, link.coord, ws.branch[k], in.q[link.coord], in.qd[row], options.dt,
                        options.implicit_drives);
      } else if (link.joint == LinkJoint::Ball) {
        term.force = -(d.damping[row] * in.qd[row]);
        if (options.implicit_drives) term.diagonal = options.dt * d.damping[row];
      }
      const T applied = is_free(link) ? T(0.0f) : in.joint_f[row];
      ws.rhs[k] = (applied - ws.bias[k]) + term.force;
      ws.diagonal[k] =
          is_kinematic(link) ? T(math::bits_float(0x7f800000)) : d.armature[row] + term.diagonal;
    }
  }
}

template <class T>
int32_t solve_accelerations(const Tree<T>& tree, const StepInputs<T>& in,
                            const StepOptions<T>& options, Workspace<T>& ws) {
  add_drives(tree, in, options, ws);
  const int32_t failed = factor(tree, in.q, ws);
  if (failed < 0) find_accelerations(tree, in.qd + tree.first_dof, ws);
  return failed;
}

// The branches that follow from a first solve; false: none has changed (in any lane; the others'
// come out of a second solve as they were).
template <class T>
bool clamp_branches(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                    Workspace<T>& ws) {
  bool changed = false;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (!has_one_dof(link)) continue;
    const int32_t k = local_dof(tree, link);
    const Branches<T> branch =
        clamped_branch(in.drives, link.dof, link.coord, ws.branch[k], in.q[link.coord],
                       in.qd[link.dof], ws.qdd[k], options.dt, options.implicit_drives);
    changed = changed || differ(branch, ws.branch[k]);
    ws.branch[k] = branch;
  }
  return changed;
}

// v = qd + dt qdd.
template <class T>
void free_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                Workspace<T>& ws) {
  for (int32_t k = 0; k < tree.dof_count; ++k)
    ws.qd_next[k] = in.qd[tree.first_dof + k] + options.dt * ws.qdd[k];
}

// v, clamped.
template <class T>
void clamp_rates(const Tree<T>& tree, const StepInputs<T>& in, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (!has_one_dof(link)) continue;
    const int32_t k = local_dof(tree, link);
    const T limit = in.drives.velocity_limit[link.dof], v = ws.qd_next[k];
    const auto above = v > limit, below = v < -limit;
    if (!any(either(above, below))) continue;
    ws.qd_next[k] = select(above, limit, select(below, -limit, v));
    ws.branch[k] = with(with(ws.branch[k], above, kVelocityAtUpper), below, kVelocityAtLower);
  }
}

template <class T>
void new_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
               Workspace<T>& ws) {
  free_rates(tree, in, options, ws);
  clamp_rates(tree, in, ws);
}

// qdd and the branches in the workspace, M's factor with them. The result is the dof whose pivot is
// not positive or whose acceleration is not finite (in any lane), counted from the tree's first;
// -1: none.
template <class T>
int32_t accelerate(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                   Workspace<T>& ws) {
  // Where a tree is does not change its accelerations: so coordinates are looked at on their own.
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const bool has_quaternion = link.joint == LinkJoint::Ball || is_free(link);
    for (int32_t c = 0; c < link.dofs + (has_quaternion ? 1 : 0); ++c)
      if (!is_finite(in.q[link.coord + c]))
        return local_dof(tree, link) + (c < link.dofs ? c : link.dofs - 1);
  }
  kinematics(tree, in.q, ws);
  set_wrenches(tree, in, ws);
  bias_forces(tree, in.qd + tree.first_dof, ws);
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.branch[k] = {};
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    if (has_one_dof(link))
      ws.branch[local_dof(tree, link)] = limit_branch(in.drives, link.dof, in.q[link.coord]);
  }
  int32_t failed = solve_accelerations(tree, in, options, ws);
  if (failed < 0 && clamp_branches(tree, in, options, ws))
    failed = solve_accelerations(tree, in, options, ws);
  if (failed >= 0) return failed;
  for (int32_t k = 0; k < tree.dof_count; ++k)
    if (!is_finite(ws.qdd[k])) return k;
  return -1;
}

// accelerate, and the undamped new rates.
template <class T>
int32_t forward_step(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                     Workspace<T>& ws) {
  const int32_t failed = accelerate(tree, in, options, ws);
  if (failed < 0) new_rates(tree, in, options, ws);
  return failed;
}

template <class T>
T damping_factor(const Link& link, int32_t dof_of_link, const StepOptions<T>& options) {
  return is_angular(link, dof_of_link) ? T(1.0f) - options.angular_damping * options.dt : T(1.0f);
}

// The new state, behind forward_step; rows of the arrays. Overwrites the links' states.
template <class T>
void finish_step(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                 Workspace<T>& ws, T* q_next, T* qd_next, Transform<T>* body_q,
                 SpatialVector<T>* body_qd) {
  integrate_coordinates(tree, in.q, ws.qd_next, options.dt, q_next);
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
