// Drives and limits of BALL joints; drives.h has the damping of all joints.
//
//   drive   t_k = ke_k phi_k + kd_k (qd*_k - v_k) for each dof k, where phi is the rotation vector
//           from q to the target, in the anchor's axes, at most half a turn long
//   limit   for the rotation angle a of q about the axis n: if a > limit_upper of the first dof,
//           t = n (limit_ke (limit_upper - a) - limit_kd n . v), which pushes inwards only
// Implicit drives use the values at the end of the step, approximately phi - dt v and a + dt n . v,
// with the rate v at the end. A drive then adds to the mass matrix's diagonal. A limit adds w n n^T
// with w = dt (limit_kd + dt limit_ke). The rates at the start of the step decide whether a limit
// would pull. Drives of BALL joints have no effort limits.
#pragma once

#include "novaphy/dynamics/articulation/drives.h"
#include "novaphy/dynamics/articulation/rotation_vector.h"
#include "novaphy/dynamics/articulation/tangents.h"

namespace novaphy::articulation {

template <class T>
Vec3<T> three(const T* x) {
  return {x[0], x[1], x[2]};
}

// Returns the rotation vector phi to the target (rad), or 0 without a drive.
template <class T>
Vec3<T> target_rotation(const Link& link, const StepInputs<T>& in) {
  const T o = T(0.0f), *const ke = in.target_ke + link.dof;
  if (!any(either(either(ke[0] > o, ke[1] > o), ke[2] > o))) return {o, o, o};
  return rotation_vector(math::multiply(unit_quaternion(in.target_q + link.coord),
                                        math::conjugate(unit_quaternion(in.q + link.coord))));
}
// Returns the drive law of dof j, in which the dof's position counts as 0 and the target as phi_j.
template <class T>
DriveLaw<T> ball_law(const Link& link, int32_t j, const StepInputs<T>& in,
                     const Branches<T>& branch, const Vec3<T>& phi, bool implicit) {
  const T error[3] = {phi.x, phi.y, phi.z};
  DriveLaw<T> law = drive_law(in, link.dof + j, link.coord, branch, implicit);
  law.target = error[j];
  return law;
}

// The limit of a BALL joint. The branch of the joint's first dof says whether the limit acts.
template <class T>
struct BallLimit {
  Vec3<T> turn{}, axis{};  // rotation vector of q; the axis n if the limit acts
  T angle{};
  DriveLaw<T> law{};  // zero stiffness and damping if the limit does not act
};
template <class T>
BallLimit<T> ball_limit(const Link& link, const StepInputs<T>& in, const Branches<T>& branch) {
  const T o = T(0.0f), one = T(1.0f);
  BallLimit<T> limit{{o, o, o}, {o, o, o}, o, limit_law(in, link.dof, branch)};
  const auto acts = limit_acts<T>(branch);
  limit.law.stiffness = select(acts, limit.law.stiffness, o);
  limit.law.rate = select(acts, limit.law.rate, o);
  if (!any(acts)) return limit;
  limit.turn = rotation_vector(unit_quaternion(in.q + link.coord));
  limit.angle = square_root(select(acts, math::dot(limit.turn, limit.turn), one));
  limit.axis = limit.turn * (one / limit.angle);
  return limit;
}
template <class T>
NOVAPHY_SELDOM Branches<T> ball_branch(const Link& link, const StepInputs<T>& in,
                                       const StepOptions<T>& options) {
  const T o = T(0.0f), upper = in.limit_upper[link.dof], half_turn = T(3.14159274f);
  if (!any(upper < half_turn)) return {};
  const Vec3<T> turn = rotation_vector(unit_quaternion(in.q + link.coord));
  const Branches<T> above =
      limit_branch(in, link.dof, square_root(math::dot(turn, turn))) & kAboveLimit;
  if (!options.implicit_drives || !any(has(above, kOutside))) return above;
  const BallLimit<T> limit = ball_limit(link, in, above);
  const T rate = math::dot(limit.axis, three(in.qd + link.dof));
  const T force = drive_term(limit.law, limit.angle, rate, options.dt, true).force;
  return with(above, both(has(above, kOutside), force > o), kLimitReleased);
}
template <class T>
void set_ball_branches(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                       Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i)
    if (is_ball(tree.links[i]))
      ws.branch[local_dof(tree, tree.links[i])] = ball_branch(tree.links[i], in, options);
}

// Computes the terms of the joint's three dofs, including damping. `cone`: sqrt(w) n of the limit.
template <class T>
NOVAPHY_SELDOM void ball_terms(const Link& link, const StepInputs<T>& in,
                               const StepOptions<T>& options, const Branches<T>& branch,
                               DriveTerm<T>* terms, T* cone) {
  const T o = T(0.0f), *const v = in.qd + link.dof, dt = options.dt;
  const bool implicit = options.implicit_drives;
  const Vec3<T> phi = target_rotation(link, in);
  const BallLimit<T> limit = ball_limit(link, in, branch);
  const DriveTerm<T> stop =
      drive_term(limit.law, limit.angle, math::dot(limit.axis, three(v)), dt, implicit);
  const T n[3] = {limit.axis.x, limit.axis.y, limit.axis.z};
  const auto stiff = stop.diagonal > o;
  const T root = select(stiff, square_root(select(stiff, stop.diagonal, T(1.0f))), o);
  for (int32_t j = 0; j < 3; ++j) {
    const T damping = in.damping[link.dof + j];
    const DriveTerm<T> drive =
        drive_term(ball_law(link, j, in, branch, phi, implicit), o, v[j], dt, implicit);
    terms[j] = {(drive.force - damping * v[j]) + n[j] * stop.force,
                implicit ? drive.diagonal + dt * damping : drive.diagonal};
    cone[j] = n[j] * root;
  }
}

// Adds the gradient of lambda . (c c^T) x by the vectors c (`cone`, sqrt(w) n) of all joints.
template <class T>
NOVAPHY_SELDOM void cones_vjp(const Tree<T>& tree, const T* cone, const T* lambda, const T* x,
                              T* gradient) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    if (!is_ball(tree.links[i])) continue;
    const int32_t k = local_dof(tree, tree.links[i]);
    const Vec3<T> c = three(cone + k);
    const T of_lambda = math::dot(c, three(lambda + k)), of_x = math::dot(c, three(x + k));
    for (int32_t j = k; j < k + 3; ++j)
      gradient[j] = gradient[j] + (lambda[j] * of_x + x[j] * of_lambda);
  }
}

template <class T>
void add_vector(const Vec3<T>& v, T* to) {
  to[0] = to[0] + v.x;
  to[1] = to[1] + v.y;
  to[2] = to[2] + v.z;
}

// Adds the gradients of a step by the limit's parameters, q and qd. `qdd`: accelerations. `lambda`:
// the joint's adjoint. Pointers are to the first of the joint's three dofs. `of_cone`: the gradient
// by `cone` from sources other than lambda and qdd.
template <class T>
void ball_limit_gradient(const Link& link, const StepInputs<T>& in, const StepOptions<T>& options,
                         const Branches<T>& branch, const T* qdd, const T* lambda, const T* of_cone,
                         T* q_gradient, T* qd_gradient, const StepGradient<T>& g) {
  using G = StepGradient<T>;
  const auto acts = limit_acts<T>(branch);
  if (!any(acts)) return;
  const T o = T(0.0f), one = T(1.0f), dt = options.implicit_drives ? options.dt : o;
  const BallLimit<T> limit = ball_limit(link, in, branch);
  const Vec3<T>&n = limit.axis, v_end = three(in.qd + link.dof) + three(qdd) * dt;
  const Vec3<T> along = three(lambda), cone = three(of_cone);
  const T push = math::dot(along, n), rate = math::dot(n, v_end);
  const T stiffness = limit.law.stiffness, damped = limit.law.rate + dt * stiffness;
  const T depth = limit.law.target - limit.angle, force = stiffness * depth - damped * rate;
  // Contacts depend on w through sqrt(w) in the mass matrix.
  const auto stiff = both(acts, dt * damped > o);
  const T root = select(stiff, square_root(select(stiff, dt * damped, one)), o);
  const T by_w = select(stiff, math::dot(n, cone) / (select(stiff, root, one) * T(2.0f)), o);
  const T by_kd = dt * by_w, by_ke = dt * by_kd;
  put(g, &G::limit_upper, link.dof, select(acts, stiffness * push, o));
  put(g, &G::limit_ke, link.dof, select(acts, (depth - dt * rate) * push - by_ke, o));
  put(g, &G::limit_kd, link.dof, select(acts, -(rate * push) - by_kd, o));
  const Vec3<T> by_n = (along * force - v_end * (damped * push)) - cone * root;
  const Vec3<T> across = by_n - n * math::dot(n, by_n);
  const Vec3<T> by_turn = across * (one / limit.angle) - n * (stiffness * push);
  add_vector(rotation_vector_vjp(limit.turn, by_turn, 1.0f), q_gradient);
  add_vector(n * -(damped * push), qd_gradient);
}

// Adds the gradients of drive_gradient for the joint's three dofs, and those of the limit.
template <class T>
NOVAPHY_SELDOM void ball_gradient(const Link& link, const StepInputs<T>& in,
                                  const StepOptions<T>& options, const Branches<T>& branch,
                                  const T* qdd, const T* lambda, const T* diagonal,
                                  const T* of_cone, T* q_gradient, T* qd_gradient,
                                  const StepGradient<T>& g) {
  const T o = T(0.0f);
  const Vec3<T> phi = target_rotation(link, in);
  const T turn[3] = {phi.x, phi.y, phi.z};
  T back[3] = {o, o, o};  // gradient by a dof's position: minus that by phi
  for (int32_t j = 0; j < 3; ++j)
    drive_gradient(link, j, in, options, branch, turn + j, qdd[j], lambda[j], diagonal[j], o, o,
                   back[j], qd_gradient[j], g);
  const Vec3<T> h = -three(back);
  const T* const target = in.target_q + link.coord;
  const T inverse = T(1.0f) / quat_length(Quat<T>{target[0], target[1], target[2], target[3]});
  const Quat<T> to = scaled(
      quat_from_tangent(unit_quaternion(target), rotation_vector_vjp(phi, h, 1.0f)), inverse);
  const T numbers[4] = {to.x, to.y, to.z, to.w};
  for (int32_t c = 0; c < 4; ++c) put(g, &StepGradient<T>::target_q, link.coord + c, numbers[c]);
  add_vector(-rotation_vector_vjp(phi, h, -1.0f), q_gradient);
  ball_limit_gradient(link, in, options, branch, qdd, lambda, of_cone, q_gradient, qd_gradient, g);
}

}  // namespace novaphy::articulation
