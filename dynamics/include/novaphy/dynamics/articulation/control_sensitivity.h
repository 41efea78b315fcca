// The derivative of a tree's state by parameters of its control, propagated step by step.
//
// Let x be the change of the dof forces by a parameter. The change x has parts through the target
// or torque, and through drives and damping by the changes dq and dv of the state. M, branches and
// new rates are those of the step (step.h):
//   dv' = dv + dt M^-1 x, 0 for dofs at their velocity limits
//   dq' = dq + dt dv' (FREE: angular tangents by the derivative of the Cayley map)
//   then dv' of angular dofs times 1 - angular_damping dt
// Label "frozen": x leaves out the changes of the mass matrix, the bias and the wrenches with the
// state. dq and dv are tangents (tree.h). Supports trees of FIXED and one-dof joints, with an
// optional FREE joint at the root.
#pragma once

#include "novaphy/dynamics/articulation/step.h"

namespace novaphy::articulation {

// The derivative of a control by a parameter, indexed by the tree's dofs. Null: zero.
template <class T>
struct ControlTangent {
  const T* target_q = nullptr;
  const T* target_qd = nullptr;
  const T* force = nullptr;  // for a FREE joint, a world wrench about the center of mass
};

// Computes x after forward_step, indexed by the tree's dofs.
template <class T>
void frozen_force_change(const Tree<T>& tree, const StepInputs<T>& in,
                         const StepOptions<T>& options, const Workspace<T>& ws,
                         const ControlTangent<T>& control, const T* dq, const T* dv, T* x) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const int32_t k = local_dof(tree, link);
    if (is_free(link)) {
      for (int32_t o = 0; o < 6; o += 3) {
        Vec3<T> f = {T(0.0f), T(0.0f), T(0.0f)};
        if (control.force)
          f = math::rotate_inverse(
              ws.links[i].anchor_q,
              Vec3<T>{control.force[k + o], control.force[k + o + 1], control.force[k + o + 2]});
        x[k + o] = f.x;
        x[k + o + 1] = f.y;
        x[k + o + 2] = f.z;
      }
    }
    if (!has_one_dof(link)) continue;
    const int32_t branch = ws.branch[k];
    DriveLaw<T> law = drive_law(in, link.dof, link.coord, branch, options.implicit_drives);
    if (has(branch, kEffortClamped)) law.stiffness = law.rate = T(0.0f);
    T force = control.force ? control.force[k] : T(0.0f);
    if (control.target_q) force = force + law.stiffness * control.target_q[k];
    if (control.target_qd && in.target_mode[link.dof] != 1)
      force = force + law.rate * control.target_qd[k];
    if (limit_acts<T>(branch)) {
      const DriveLaw<T> stop = limit_law(in, link.dof, branch);
      law.stiffness = law.stiffness + stop.stiffness;
      law.rate = law.rate + stop.rate;
    }
    T rate = law.rate + in.damping[link.dof];
    if (options.implicit_drives) rate = rate + options.dt * law.stiffness;
    x[k] = (force - law.stiffness * dq[k]) - rate * dv[k];
  }
}

// Converts dv of the new rates before angular damping to dq' and dv', in place. `rates`: the new
// rates before damping.
template <class T>
void integrate_changes(const Tree<T>& tree, const StepOptions<T>& options, const T* rates, T* dq,
                       T* dv) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const int32_t k = local_dof(tree, link);
    if (is_free(link)) {
      const T half = T(0.5f) * options.dt;
      const Vec3<T> y = {half * rates[k + 3], half * rates[k + 4], half * rates[k + 5]};
      const Vec3<T> e = {dq[k + 3], dq[k + 4], dq[k + 5]}, u = {dv[k + 3], dv[k + 4], dv[k + 5]};
      const T scale = options.dt / (T(1.0f) + math::dot(y, y));
      const Vec3<T> next = math::rotate(cayley(y), e) + (u + math::cross(y, u)) * scale;
      for (int32_t o = 0; o < 3; ++o) dq[k + o] = dq[k + o] + options.dt * dv[k + o];
      dq[k + 3] = next.x;
      dq[k + 4] = next.y;
      dq[k + 5] = next.z;
    } else if (has_one_dof(link)) {
      dq[k] = dq[k] + options.dt * dv[k];
    }
    for (int32_t j = 0; j < link.dofs; ++j)
      dv[k + j] = dv[k + j] * damping_factor(link, j, options);
  }
}

// Position and velocity in the world of a link's point (m, m/s). `local`: the point in the frame of
// the link's body (m). Call this after link_frames and link_motions.
template <class T>
struct PointState {
  Vec3<T> position{}, velocity{};
};
template <class T>
PointState<T> point_state(const Workspace<T>& ws, int32_t link, const Vec3<T>& local) {
  const LinkState<T>& s = ws.links[link];
  const Vec3<T> p = s.p + math::rotate(s.q, local);
  return {s.origin + p, math::motion_at(s.v, p).linear};
}
// Computes the Jacobian of the point: calls column(k, velocity) for each dof k that moves the
// point.
template <class T, class Column>
void point_jacobian(const Tree<T>& tree, const Workspace<T>& ws, int32_t link, const Vec3<T>& local,
                    Column&& column) {
  const LinkState<T>& s = ws.links[link];
  const Vec3<T> p = s.p + math::rotate(s.q, local);
  for (int32_t on = link; on >= 0; on = tree.links[on].parent) {
    const int32_t first = local_dof(tree, tree.links[on]);
    for (int32_t k = first; k < first + tree.links[on].dofs; ++k)
      column(k, math::motion_at(ws.axes[k], p).linear);
  }
}

// Converts a tangent (indexed by the tree's dofs) to a change of q. put(row, value): row of the
// model's coordinates.
template <class T, class Put>
void tangent_to_coordinates(const Tree<T>& tree, const T* q, const T* tangent, Put&& put) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const T* const e = tangent + local_dof(tree, link);
    if (has_one_dof(link)) put(link.coord, e[0]);
    if (!is_free(link)) continue;
    const T* const x = q + link.coord;
    const Quat<T> raw = {x[3], x[4], x[5], x[6]};
    const Quat<T> r = scaled(raw, T(1.0f) / quat_length(raw));
    const Vec3<T> turn = {e[3], e[4], e[5]};
    const Vec3<T> p =
        Vec3<T>{e[0], e[1], e[2]} - math::cross(turn, math::rotate(r, com_in_joint(tree, link)));
    const T half = T(0.5f);
    const Quat<T> d = scaled(math::multiply(Quat<T>{turn.x, turn.y, turn.z, T(0.0f)}, raw), half);
    const T numbers[7] = {p.x, p.y, p.z, d.x, d.y, d.z, d.w};
    for (int32_t k = 0; k < 7; ++k) put(link.coord + k, numbers[k]);
  }
}

}  // namespace novaphy::articulation
