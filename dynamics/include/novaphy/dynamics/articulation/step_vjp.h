// The exact adjoint of a step (step.h), from its inputs, its accelerations and its branches.
//
// With the gradients h of q' (by tangents) and g of qd', and u = qd + dt qdd:
//   gu = dt h (BALL and FREE: through the Cayley map) + g (1 - angular_damping dt)
//   lambda = M^-1 dt gu, and 0 for dofs at their velocity limits. These dofs get
//     gu = (H lambda) / dt instead; the difference to the former gu is the gradient by the limit
//   gradients: by joint_f lambda, by q h - dPhi/dq - K lambda,
//     by qd gu - dPhi/dqd - (D + dt K) lambda, with the stiffness K and damping D of drives, and
//     Phi of inverse_dynamics_vjp.h at (q, qd, qdd)
// Gradients by drives and masses follow in the same way. The adjoint needs only (q, qd, qdd,
// branches) of a step. The branches (which limits and clamps act) are constant, so the gradient is
// exact where no branch changes.
#pragma once

#include "novaphy/dynamics/articulation/inverse_dynamics_vjp.h"
#include "novaphy/dynamics/articulation/kinematics_vjp.h"
#include "novaphy/dynamics/articulation/step.h"
#include "novaphy/math/matrix.h"

namespace novaphy::articulation {

// Gradients by the results of a step. Null: zero.
template <class T>
struct StepOutputGradient {
  const T *q, *qd;
  const Transform<T>* body_q;
  const SpatialVector<T>* body_qd;
};

// The adjoint's memory besides the workspace. `tangent` and `rate` {dofs}: gradients by q and u;
// `scratch` {3 dofs}. Arrays without a shape comment have a row per link.
template <class T>
struct AdjointMemory {
  T *tangent = nullptr, *rate = nullptr, *scratch = nullptr;
  T* diagonal = nullptr;  // {dofs}: gradient by the diagonal added to H, from matrix_vjp
  T* cone = nullptr;      // {dofs}: gradient by ws.cone, from matrix_vjp
  T* stops = nullptr;     // {2 dofs}: gradient by the upper and lower limits that stop shifts
  T* bounce = nullptr;    // {dofs}: gradient by qd from contacts that bounce, of dofs at a bound
  SpatialVector<T>* wrench = nullptr;
  T *mass = nullptr, *moved_mass = nullptr;
  Vec3<T>*com = nullptr, *moved_com = nullptr;
  Mat33<T>*inertia = nullptr, *moved_inertia = nullptr;
};
template <class T>
int64_t adjoint_bytes(int32_t links, int32_t dofs) {
  const int64_t per_link =
      sizeof(SpatialVector<T>) + 2 * (sizeof(T) + sizeof(Vec3<T>) + sizeof(Mat33<T>));
  return (10 * dofs * static_cast<int64_t>(sizeof(T)) + links * per_link + 7) / 8 * 8;
}
template <class T>
AdjointMemory<T> make_adjoint_memory(void* memory, int32_t links, int32_t dofs) {
  AdjointMemory<T> m;
  m.tangent = static_cast<T*>(memory);
  m.rate = m.tangent + dofs;
  m.scratch = m.rate + dofs;
  m.diagonal = m.scratch + 3 * dofs;
  m.cone = m.diagonal + dofs;
  m.stops = m.cone + dofs;
  m.bounce = m.stops + 2 * dofs;
  m.wrench = reinterpret_cast<SpatialVector<T>*>(m.bounce + dofs);
  m.mass = reinterpret_cast<T*>(m.wrench + links);
  m.moved_mass = m.mass + links;
  m.com = reinterpret_cast<Vec3<T>*>(m.moved_mass + links);
  m.moved_com = m.com + links;
  m.inertia = reinterpret_cast<Mat33<T>*>(m.moved_com + links);
  m.moved_inertia = m.inertia + links;
  return m;
}

// Returns the contribution of the gradient g by a FREE joint's new position p' to the gradient by
// its body's center of mass: p' = x_com' - R(r') rc.
template <class T>
Vec3<T> free_com_gradient(const Tree<T>& tree, const Link& link, const T* q, const T* q_next,
                          const Vec3<T>& g) {
  const T *const a = q + link.coord + 3, *const b = q_next + link.coord + 3;
  const Quat<T> raw = {a[0], a[1], a[2], a[3]};
  const Quat<T> r = scaled(raw, T(1.0f) / quat_length(raw)), next = {b[0], b[1], b[2], b[3]};
  const Vec3<T> in_joint = math::rotate_inverse(r, g) - math::rotate_inverse(next, g);
  return link.frame_c < 0 ? in_joint : math::rotate(tree.X_c[link.frame_c].q, in_joint);
}

// The adjoint of the coordinate update: converts gradients by the new state to gradients by u
// (`rate`) and q (`tangent`).
template <class T>
void integrate_coordinates_vjp(const Tree<T>& tree, const T* qd, const T& dt, T* tangent, T* rate) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    T* const h = tangent + local_dof(tree, link);
    T* const g = rate + local_dof(tree, link);
    const T* const u = qd + local_dof(tree, link);
    Joints::visit(link.joint, [&](auto joint) { joint.integrate_vjp(u, dt, h, g); });
  }
}

template <class T>
void add_mass_gradients(const Tree<T>& tree, const StepGradient<T>& g,
                        const AdjointMemory<T>& memory) {
  using G = StepGradient<T>;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const int32_t body = tree.links[i].body;
    if (body < 0) continue;
    put(g, &G::body_f, body, -memory.wrench[i]);
    put(g, &G::mass, body, -(memory.mass[i] + memory.moved_mass[i]));
    put(g, &G::com, body, memory.moved_com[i] - memory.com[i]);
    put(g, &G::inertia, body, math::scale(memory.inertia[i] + memory.moved_inertia[i], T(-1.0f)));
  }
}

// Computes the gradients by the new coordinates (tangents) and rates, including those through the
// body poses, in `tangent` and `rate`. q_next and qd_next are indexed as in the model's arrays.
template <class T>
void step_vjp_end(const Tree<T>& tree, const StepInputs<T>& in, const T* q_next, const T* qd_next,
                  const StepOutputGradient<T>& out, Workspace<T>& ws, AdjointMemory<T>& memory) {
  const T o = T(0.0f);
  const int32_t n = tree.dof_count, row0 = tree.first_dof;
  T *const tangent = memory.tangent, *const rate = memory.rate, *const lambda = memory.scratch;

  // Gradients of the poses first, then of the coordinates.
  for (int32_t i = 0; i < tree.link_count; ++i) {
    memory.moved_com[i] = {o, o, o};
    memory.moved_mass[i] = o;
    memory.moved_inertia[i] = Mat33<T>{};
  }
  for (int32_t k = 0; k < n; ++k) tangent[k] = rate[k] = memory.diagonal[k] = memory.cone[k] = o;
  for (int32_t k = 0; k < n; ++k) memory.bounce[k] = o;
  if (out.body_q || out.body_qd) {
    link_frames(tree, q_next, ws);
    link_motions(tree, qd_next + row0, ws);
    KinematicsGradient<T> of_poses{tangent, rate, memory.moved_com};
    kinematics_vjp(tree, qd_next + row0, out.body_q, out.body_qd, ws, of_poses);
  }
  if (out.q) {
    gradient_to_tangent(tree, q_next, out.q, lambda);
    for (int32_t k = 0; k < n; ++k) tangent[k] = tangent[k] + lambda[k];
  }
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const int32_t first = local_dof(tree, link);
    if (is_free(link)) {
      const Vec3<T> moved = {tangent[first], tangent[first + 1], tangent[first + 2]};
      memory.moved_com[i] =
          memory.moved_com[i] + free_com_gradient(tree, link, in.q, q_next, moved);
    }
    for (int32_t j = 0; out.qd && j < link.dofs; ++j)
      rate[first + j] = rate[first + j] + out.qd[link.dof + j];
  }
  gather_mimics(tree, tangent);
  gather_mimics(tree, rate);
}

// First of three parts of the adjoint of a step: computes the gradients by q and u from those of
// the new state, in `tangent` and `rate`. scratch[dofs..] gets the contribution of q' to `rate`.
// `qdd`, `branch` (as numbers), `q_next` and `qd_next` are results of the step, indexed as in the
// model's arrays.
template <class T>
void step_vjp_rates(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                    const T* qdd, const T* branch, const T* q_next, const T* qd_next,
                    const StepOutputGradient<T>& out, Workspace<T>& ws, AdjointMemory<T>& memory) {
  step_vjp_end(tree, in, q_next, qd_next, out, ws, memory);
  const int32_t n = tree.dof_count, row0 = tree.first_dof;
  T *const tangent = memory.tangent, *const rate = memory.rate;
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    for (int32_t j = 0; j < link.dofs; ++j) {
      T& to = rate[local_dof(tree, link) + j];
      to = to * damping_factor(link, j, options);
    }
  }

  // The adjoint of the coordinate update.
  for (int32_t k = 0; k < n; ++k) {
    ws.branch[k] = to_branches(branch[row0 + k]);
    ws.qdd[k] = qdd[row0 + k];
  }
  free_rates(tree, in, options, ws);
  T* const of_moves = memory.scratch + n;
  for (int32_t k = 0; k < n; ++k) of_moves[k] = rate[k];
  integrate_coordinates_vjp(tree, moving_rates(tree, in, options, ws), options.dt, tangent, rate);
  for (int32_t k = 0; k < n; ++k) of_moves[k] = rate[k] - of_moves[k];
  for (int32_t k = 0; k < 2 * n; ++k) memory.stops[k] = T(0.0f);
  if (ws.shift == nullptr) return;
  const T o = T(0.0f);
  for_drives(tree, [&](const Link& link, int32_t k) {
    const T shift = ws.shift[k], kept = kept_shift(link, in, options, ws.qd_next[k], shift);
    const auto cut = either(kept < shift, shift < kept);
    const auto at_upper = both(cut, kept > o), at_lower = both(cut, kept < o);
    const auto stops = either(at_upper, at_lower);
    memory.stops[k] = select(at_upper, tangent[k], o);
    memory.stops[n + k] = select(at_lower, tangent[k], o);
    tangent[k] = select(stops, o, tangent[k]);
    rate[k] = select(stops, rate[k] - of_moves[k], rate[k]);
    of_moves[k] = select(cut, o, of_moves[k]);
  });
}

// Second part of the adjoint of a step: recomputes the dynamics at the start of the step, and the
// factor of the mass matrix M.
template <class T>
void step_vjp_dynamics(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                       Workspace<T>& ws) {
  kinematics(tree, in.q, ws);
  set_wrenches(tree, in, ws);
  inverse_dynamics(tree, in.qd + tree.first_dof, ws.qdd, ws, ws.bias);
  add_drives(tree, in, options, ws.bias, ws);
  factor(tree, in.q, ws);
}
// Optional, between the parts: subtracts the gradient of lambda . dM x. The first third of
// `scratch` is lambda, the last third is x. Call step_vjp_dynamics again afterwards.
template <class T>
void matrix_vjp(const Tree<T>& tree, Workspace<T>& ws, AdjointMemory<T>& memory) {
  const T o = T(0.0f);
  Tree<T> weightless = tree;
  weightless.gravity = {o, o, o};
  const T *const lambda = memory.scratch, *const x = lambda + 2 * tree.dof_count;
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    ws.qd_next[k] = o;
    memory.diagonal[k] = memory.diagonal[k] + lambda[k] * x[k];
  }
  cones_vjp(tree, ws.cone, lambda, x, memory.cone);
  for (int32_t i = 0; i < tree.link_count; ++i) ws.links[i].wrench = zero_spatial<T>();
  inverse_dynamics(weightless, ws.qd_next, x, ws, ws.bias);
  InverseDynamicsGradient<T> phi{ws.rhs,      nullptr,    nullptr,        nullptr,
                                 memory.mass, memory.com, memory.inertia, {}};
  inverse_dynamics_vjp(weightless, ws.qd_next, x, lambda, ws, phi);
  for (int32_t k = 0; k < tree.dof_count; ++k) memory.tangent[k] = memory.tangent[k] - ws.rhs[k];
  for (int32_t i = 0; i < tree.link_count; ++i) {
    memory.moved_com[i] = memory.moved_com[i] - memory.com[i];
    memory.moved_mass[i] = memory.moved_mass[i] + memory.mass[i];
    memory.moved_inertia[i] = memory.moved_inertia[i] + memory.inertia[i];
  }
}
// Computes lambda = M^-1 dt gu in `scratch`. The effect of contacts on u must already be subtracted
// from `rate`.
template <class T>
void step_vjp_solve(const Tree<T>& tree, const StepOptions<T>& options, Workspace<T>& ws,
                    AdjointMemory<T>& memory) {
  for (int32_t k = 0; k < tree.dof_count; ++k) memory.scratch[k] = options.dt * memory.rate[k];
  solve(tree, ws, memory.scratch);
}

// Adds the gradients by the rate bound (rate_bounds.h) that a dof is at, if any. Returns the
// gradient by its velocity limit.
template <class T>
T bound_vjp(const Link& link, const StepInputs<T>& in, const StepOptions<T>& options, int32_t k,
            const Branches<T>& branch, const T& h_lambda, int32_t dofs, AdjointMemory<T>& memory) {
  const auto held = has(branch, kVelocityClamped);
  T *const rate = memory.rate + k, *const stops = memory.stops + k;
  const T left = h_lambda / options.dt, pull = select(held, *rate - left, T(0.0f));
  const HeldRate<T> to = held_rate(in, options, link.dof, link.coord, branch);
  const T by_velocity = select(held, to.velocity_limit * pull, T(0.0f));
  *rate = select(held, left + memory.bounce[k], *rate);
  if (!options.limit_rows) return by_velocity;
  *rate = *rate + to.qd * pull;
  memory.tangent[k] = memory.tangent[k] + to.q * pull;
  stops[0] = stops[0] + to.upper * pull;
  stops[dofs] = stops[dofs] + to.lower * pull;
  return by_velocity;
}

// Third part of the adjoint of a step: computes the gradients by the inputs from lambda, the
// solution of the adjoint linear system.
template <class T>
void step_vjp_inputs(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                     const StepGradient<T>& g, Workspace<T>& ws, AdjointMemory<T>& memory) {
  using G = StepGradient<T>;
  const T o = T(0.0f);
  const int32_t n = tree.dof_count, row0 = tree.first_dof;
  T *const tangent = memory.tangent, *const rate = memory.rate;
  T *const lambda = memory.scratch, *const phi_q = lambda + n, *const phi_qd = phi_q + n;
  const auto holds = holds_rates(tree, ws);
  T* const h_lambda = any(holds) ? ws.rhs : nullptr;
  InverseDynamicsGradient<T> phi{phi_q,       phi_qd,     h_lambda,       memory.wrench,
                                 memory.mass, memory.com, memory.inertia, {}};
  inverse_dynamics_vjp(tree, in.qd + row0, ws.qdd, lambda, ws, phi);
  if (any(holds)) gather_mimics(tree, h_lambda);
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t k = local_dof(tree, link) + j;
      const T by_limit = any(holds) && has_one_dof(link)
                             ? bound_vjp(link, in, options, k, ws.branch[k], h_lambda[k], n, memory)
                             : o;
      put(g, &G::velocity_limit, row0 + k, by_limit);
      tangent[k] = tangent[k] - phi_q[k];
      rate[k] = rate[k] - phi_qd[k];
      if (!is_ball(link))
        drive_gradient(link, j, in, options, ws.branch[k], static_cast<const T*>(nullptr),
                       ws.qdd[k], lambda[k], memory.diagonal[k], memory.stops[k],
                       memory.stops[n + k], tangent[k], rate[k], g);
    }
    const int32_t first = local_dof(tree, link);
    if (is_ball(link))
      ball_gradient(link, in, options, ws.branch[first], ws.qdd + first, lambda + first,
                    memory.diagonal + first, memory.cone + first, tangent + first, rate + first, g);
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t k = first + j;
      put(g, &G::qd, row0 + k, rate[k]);
      T applied = lambda[k];
      if (is_free(link)) {  // a world wrench
        const SpatialVector<T> w = -memory.wrench[i];
        const T parts[6] = {w.linear.x,  w.linear.y,  w.linear.z,
                            w.angular.x, w.angular.y, w.angular.z};
        applied = parts[j];
      }
      put(g, &G::joint_f, row0 + k, applied);
    }
    if (is_free(link))
      for (int32_t c = 0; c < coordinate_count(link); ++c) put(g, &G::target_q, link.coord + c, o);
  }
  add_mass_gradients(tree, g, memory);
  if (g.q)
    tangent_to_gradient(tree, in.q, tangent,
                        [&](int32_t row, const T& value) { put(g, &G::q, row, value); });
}

// Runs all three parts.
template <class T>
void step_vjp(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
              const T* qdd, const T* branch, const T* q_next, const T* qd_next,
              const StepOutputGradient<T>& out, const StepGradient<T>& g, Workspace<T>& ws,
              AdjointMemory<T>& memory) {
  step_vjp_rates(tree, in, options, qdd, branch, q_next, qd_next, out, ws, memory);
  step_vjp_dynamics(tree, in, options, ws);
  step_vjp_solve(tree, options, ws, memory);
  step_vjp_inputs(tree, in, options, g, ws, memory);
}

}  // namespace novaphy::articulation
