// Articulated-body algorithm: applies M^-1 of a tree link by link, without forming the mass matrix
// M.
//
//   M^-1 = (1 - H psi K)^T D^-1 (1 - H psi K)
// The articulated inertia P of a link is the inertia that the link shows with its descendants and
// their free joints. P is the inertia of the link plus P - K D K^T of each child, where D = S^T P S
// + diagonal and K = P S D^-1 of the child's joint. The dofs of a joint are eliminated one by one,
// as if massless links were between them.
//
// Motions and forces of a link refer to a reference point of the link, in the axes of its body.
// This point is the joint, or the center of mass for FREE joints. Accelerations are those of this
// point. No large terms cancel, so float32 reaches 1e-6 at 200 links. The errors of a mass matrix
// grow with the fourth power of the number of links in a row.
//
// Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7; Rodriguez, Jain and
// Kreutz-Delgado, A spatial operator algebra for manipulator modeling and control (IJRR 1991).
#pragma once

#include "novaphy/dynamics/articulation/kinematics.h"
#include "novaphy/math/matrix.h"

// Functions for long trees are not inlined. This keeps device kernels and their callers small.
#ifdef NOVAPHY_KERNEL
#define NOVAPHY_LONG_TREES __attribute__((noinline))
#else
#define NOVAPHY_LONG_TREES __attribute__((noinline, flatten))
#endif

namespace novaphy::articulation {

// Data of a link and of a dof. Both are stored in the memory of the workspace's matrix.
template <class T>
struct ArticulatedLink {
  Mat33<T> turn{};  // rotation from the link's axes to its parent's
  Vec3<T> at{};     // the link's reference point from the parent's, parent axes; 0: root
};
template <class T>
struct ArticulatedDof {
  Vec3<T> axis{};           // axis of S, which is linear or angular
  SpatialVector<T> gain{};  // K = P S D^-1
  T inverse{};              // 1 / D
};
template <class T>
ArticulatedLink<T>* articulated_links(const Workspace<T>& ws) {
  return reinterpret_cast<ArticulatedLink<T>*>(ws.matrix);
}
template <class T>
ArticulatedDof<T>* articulated_dofs(const Tree<T>& tree, const Workspace<T>& ws) {
  return reinterpret_cast<ArticulatedDof<T>*>(articulated_links(ws) + tree.link_count);
}
// Returns the corrections of accelerate_links, one number per dof, stored behind the dofs.
template <class T>
T* articulated_corrections(const Tree<T>& tree, const Workspace<T>& ws) {
  return reinterpret_cast<T*>(articulated_dofs(tree, ws) + tree.dof_count);
}

template <class T>
Vec3<T>& part(bool linear, SpatialVector<T>& x) {
  return linear ? x.linear : x.angular;
}

// Returns the reference point of a link, in its body's frame.
template <class T>
Vec3<T> link_point(const Tree<T>& tree, const Link& link) {
  if (is_free(link)) return link.body < 0 ? Vec3<T>{} : tree.com[link.body];
  return link.frame_c < 0 ? Vec3<T>{} : tree.X_c[link.frame_c].p;
}

// Sets a link's frame relative to its parent's frame, and the axes of the link's joint.
template <class T>
void set_articulated_frame(const Tree<T>& tree, const Link& link, const T* q, ArticulatedLink<T>& s,
                           ArticulatedDof<T>* dofs) {
  const Transform<T> x_p = link.frame_p < 0 ? Transform<T>::identity() : tree.X_p[link.frame_p];
  const Transform<T> x_c = link.frame_c < 0 ? Transform<T>::identity() : tree.X_c[link.frame_c];
  T length = T(1.0f);
  const Transform<T> x_j = joint_transform(tree, link, q + link.coord, length);
  const Quat<T> in_joint = math::multiply(x_j.q, math::conjugate(x_c.q));
  const Quat<T> turn = math::multiply(x_p.q, in_joint);
  s.turn = math::from_columns(math::rotate(turn, unit_vector<T>(0)),
                              math::rotate(turn, unit_vector<T>(1)),
                              math::rotate(turn, unit_vector<T>(2)));
  s.at = Vec3<T>{T(0.0f), T(0.0f), T(0.0f)};
  if (link.parent >= 0) {
    Vec3<T> moved = x_j.p;
    if (is_free(link)) moved = moved + math::rotate(x_j.q, com_in_joint(tree, link));
    s.at = (x_p.p - link_point(tree, tree.links[link.parent])) + math::rotate(x_p.q, moved);
  }
  for (int32_t j = 0; j < link.dofs; ++j)
    dofs[j].axis = link.dofs == 1 ? math::rotate(x_c.q, tree.axis[link.dof])
                                  : math::rotate_inverse(in_joint, unit_vector<T>(j % 3));
}

// Returns the inertia of a link about its reference point, in its body's axes.
template <class T>
SpatialInertia<T> inertia_at_point(const Tree<T>& tree, const Link& link) {
  if (link.body < 0) return {};
  const Mat33<T>& i = tree.inertia[link.body];
  const T half = T(0.5f);
  return math::inertia_at(SpatialInertia<T>{tree.mass[link.body],
                                            {T(0.0f), T(0.0f), T(0.0f)},
                                            i.m[0][0],
                                            i.m[1][1],
                                            i.m[2][2],
                                            (i.m[0][1] + i.m[1][0]) * half,
                                            (i.m[0][2] + i.m[2][0]) * half,
                                            (i.m[1][2] + i.m[2][1]) * half},
                          link_point(tree, link) - tree.com[link.body]);
}

// Transforms a force from a link to its parent, or a motion from the parent to the link.
template <class T>
SpatialVector<T> force_to_parent(const ArticulatedLink<T>& s, const SpatialVector<T>& f) {
  const Vec3<T> linear = math::multiply(s.turn, f.linear);
  return {linear, math::multiply(s.turn, f.angular) + math::cross(s.at, linear)};
}
template <class T>
Vec3<T> turned_back(const ArticulatedLink<T>& s, const Vec3<T>& x) {
  return {math::dot(math::column(s.turn, 0), x), math::dot(math::column(s.turn, 1), x),
          math::dot(math::column(s.turn, 2), x)};
}
template <class T>
SpatialVector<T> motion_from_parent(const ArticulatedLink<T>& s, const SpatialVector<T>& m) {
  return {turned_back(s, m.linear + math::cross(m.angular, s.at)), turned_back(s, m.angular)};
}

// The articulated inertia P as blocks {linear, coupling; coupling^T, angular}. Both diagonal blocks
// are symmetric.
template <class T>
struct ArticulatedInertia {
  Mat33<T> linear{}, coupling{}, angular{};
};
template <class T>
Mat33<T> cross_matrix(const Vec3<T>& r) {
  const T o = T(0.0f);
  return {{{o, -r.z, r.y}, {r.z, o, -r.x}, {-r.y, r.x, o}}};
}
template <class T>
ArticulatedInertia<T> articulated_inertia(const SpatialInertia<T>& y) {
  const T o = T(0.0f);
  return {{{{y.mass, o, o}, {o, y.mass, o}, {o, o, y.mass}}},
          cross_matrix(-y.moment),
          {{{y.xx, y.xy, y.xz}, {y.xy, y.yy, y.yz}, {y.xz, y.yz, y.zz}}}};
}
// Stores the 21 independent entries of P in a link's state, in the memory that adjoint sweeps use.
template <class T>
void keep_inertia(const ArticulatedInertia<T>& p, LinkState<T>& s) {
  const auto &a = p.linear.m, &c = p.angular.m;
  s.w = {{a[0][0], a[1][1], a[2][2]}, {a[0][1], a[0][2], a[1][2]}};
  s.a_adjoint = {math::row(p.coupling, 0), math::row(p.coupling, 1)};
  s.v_adjoint = {math::row(p.coupling, 2), {c[0][0], c[1][1], c[2][2]}};
  s.wrench_torque = {c[0][1], c[0][2], c[1][2]};
}
template <class T>
ArticulatedInertia<T> stored_inertia(const LinkState<T>& s) {
  const auto symmetric = [](const Vec3<T>& d, const Vec3<T>& off) {
    return Mat33<T>{{{d.x, off.x, off.y}, {off.x, d.y, off.z}, {off.y, off.z, d.z}}};
  };
  const Vec3<T>&x = s.a_adjoint.linear, y = s.a_adjoint.angular, z = s.v_adjoint.linear;
  return {symmetric(s.w.linear, s.w.angular),
          {{{x.x, x.y, x.z}, {y.x, y.y, y.z}, {z.x, z.y, z.z}}},
          symmetric(s.v_adjoint.angular, s.wrench_torque)};
}

// Returns what a child adds to its parent's P: the child's P without the part that its joint takes
// up, about the parent's reference point in the parent's axes.
template <class T>
ArticulatedInertia<T> at_parent(const ArticulatedLink<T>& s, const ArticulatedInertia<T>& p) {
  const auto from_rows = [](const Vec3<T>& x, const Vec3<T>& y, const Vec3<T>& z) {
    return math::transpose(math::from_columns(x, y, z));
  };
  const auto turned = [&](const Mat33<T>& a) {  // R A R^T
    const auto column = [&](int i) { return math::multiply(s.turn, math::column(a, i)); };
    const Mat33<T> b = math::from_columns(column(0), column(1), column(2));
    const auto row = [&](int i) { return math::multiply(s.turn, math::row(b, i)); };
    return from_rows(row(0), row(1), row(2));
  };
  const auto minus = [](const Mat33<T>& a, const Mat33<T>& b) {
    Mat33<T> c;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) c.m[i][j] = a.m[i][j] - b.m[i][j];
    return c;
  };
  // Moves the reference point by r: B - A [r], and C - B^T [r] + [r] (B - A [r]), with the blocks
  // {A, B; B^T, C} of P.
  const Mat33<T> linear = turned(p.linear), coupling = turned(p.coupling);
  const auto row = [&](int i) { return math::cross(math::row(linear, i), s.at); };
  const Mat33<T> moved = minus(coupling, from_rows(row(0), row(1), row(2)));
  const auto before = [&](int i) { return math::cross(math::column(coupling, i), s.at); };
  const auto behind = [&](int i) { return math::cross(s.at, math::column(moved, i)); };
  return {linear, moved,
          math::add(minus(turned(p.angular), from_rows(before(0), before(1), before(2))),
                    math::from_columns(behind(0), behind(1), behind(2)))};
}

// Factors M = H + diag(ws.diagonal) at q (indexed as in the model's arrays). Returns the first dof,
// counted from the leaves, whose pivot is not positive (in any lane), or -1. The factorization
// stops at that dof.
template <class T>
NOVAPHY_LONG_TREES int32_t factor_links(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  ArticulatedLink<T>* const links = articulated_links(ws);
  for (int32_t i = 0; i < tree.link_count; ++i)
    keep_inertia(articulated_inertia(inertia_at_point(tree, tree.links[i])), ws.links[i]);
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    const int32_t first = local_dof(tree, link);
    ArticulatedDof<T>* const dofs = articulated_dofs(tree, ws) + first;
    set_articulated_frame(tree, link, q, links[i], dofs);
    ArticulatedInertia<T> p = stored_inertia(ws.links[i]);
    for (int32_t j = link.dofs; j-- > 0;) {
      ArticulatedDof<T>& dof = dofs[j];
      const bool linear = is_linear(link, j);
      SpatialVector<T> force =
          linear ? SpatialVector<T>{math::multiply(p.linear, dof.axis),
                                    math::multiply(math::transpose(p.coupling), dof.axis)}
                 : SpatialVector<T>{math::multiply(p.coupling, dof.axis),
                                    math::multiply(p.angular, dof.axis)};
      const T pivot = math::dot(dof.axis, part(linear, force)) + ws.diagonal[first + j];
      if (!all(pivot > T(0.0f))) return first + j;
      dof.inverse = T(1.0f) / pivot;
      dof.gain = force * dof.inverse;
      const T f[6] = {force.linear.x,  force.linear.y,  force.linear.z,
                      force.angular.x, force.angular.y, force.angular.z};
      const T k[6] = {dof.gain.linear.x,  dof.gain.linear.y,  dof.gain.linear.z,
                      dof.gain.angular.x, dof.gain.angular.y, dof.gain.angular.z};
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) {
          p.linear.m[r][c] = p.linear.m[r][c] - k[r] * f[c];
          p.coupling.m[r][c] = p.coupling.m[r][c] - k[r] * f[3 + c];
          p.angular.m[r][c] = p.angular.m[r][c] - k[3 + r] * f[3 + c];
        }
    }
    if (link.parent < 0) continue;
    LinkState<T>& parent = ws.links[link.parent];
    const ArticulatedInertia<T> more = at_parent(links[i], p), own = stored_inertia(parent);
    keep_inertia(ArticulatedInertia<T>{math::add(own.linear, more.linear),
                                       math::add(own.coupling, more.coupling),
                                       math::add(own.angular, more.angular)},
                 parent);
  }
  return -1;
}

// Solves M y = x - S^T f for y, in place in x. f: the forces in the `w` of the links, summed over
// all descendants.
template <class T>
void sweep_links(const Tree<T>& tree, const Workspace<T>& ws, T* x) {
  const ArticulatedLink<T>* const links = articulated_links(ws);
  const ArticulatedDof<T>* const dofs = articulated_dofs(tree, ws);
  for (int32_t i = tree.link_count; i-- > 0;) {
    const Link& link = tree.links[i];
    SpatialVector<T> force = ws.links[i].w;
    for (int32_t j = link.dofs; j-- > 0;) {
      const int32_t k = local_dof(tree, link) + j;
      x[k] = x[k] - math::dot(dofs[k].axis, part(is_linear(link, j), force));
      force = force + dofs[k].gain * x[k];
    }
    if (link.parent < 0) continue;
    SpatialVector<T>& parent = ws.links[link.parent].w;
    parent = parent + force_to_parent(links[i], force);
  }
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    SpatialVector<T> a = link.parent < 0
                             ? zero_spatial<T>()
                             : motion_from_parent(links[i], ws.links[link.parent].a_adjoint);
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t k = local_dof(tree, link) + j;
      x[k] = x[k] * dofs[k].inverse - math::dot(a, dofs[k].gain);
      Vec3<T>& along = part(is_linear(link, j), a);
      along = along + dofs[k].axis * x[k];
    }
    ws.links[i].a_adjoint = a;
  }
}

// Solves M x = b in place.
template <class T>
NOVAPHY_LONG_TREES void solve_links(const Tree<T>& tree, const Workspace<T>& ws, T* x) {
  for (int32_t i = 0; i < tree.link_count; ++i) ws.links[i].w = zero_spatial<T>();
  sweep_links(tree, ws, x);
}

// Computes forces in the `w` of the links by the Newton-Euler equations, minus external wrenches.
// The motions come from the rates qd and the accelerations ws.qdd (indexed by the dofs of the
// tree).
template <class T>
void link_forces(const Tree<T>& tree, const T* qd, const Workspace<T>& ws) {
  const ArticulatedLink<T>* const links = articulated_links(ws);
  const ArticulatedDof<T>* const dofs = articulated_dofs(tree, ws);
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    LinkState<T>& s = ws.links[i];
    SpatialVector<T> a = {-tree.gravity, {T(0.0f), T(0.0f), T(0.0f)}};
    Vec3<T> turning = a.angular;
    if (link.parent >= 0) {
      a = ws.links[link.parent].a_adjoint;
      turning = ws.links[link.parent].v_adjoint.angular;
    }
    a.linear = a.linear + (math::cross(a.angular, links[i].at) +
                           math::cross(turning, math::cross(turning, links[i].at)));
    a = {turned_back(links[i], a.linear), turned_back(links[i], a.angular)};
    turning = turned_back(links[i], turning);
    SpatialVector<T> rate = zero_spatial<T>(), growth = zero_spatial<T>();
    for (int32_t j = 0; j < link.dofs; ++j) {
      const int32_t k = local_dof(tree, link) + j;
      const bool linear = is_linear(link, j);
      part(linear, rate) = part(linear, rate) + dofs[k].axis * qd[k];
      part(linear, growth) = part(linear, growth) + dofs[k].axis * ws.qdd[k];
    }
    a.linear = a.linear + (math::cross(turning, rate.linear) * T(2.0f) + growth.linear);
    a.angular = a.angular + (math::cross(turning, rate.angular) + growth.angular);
    turning = turning + rate.angular;
    s.a_adjoint = a;
    s.v_adjoint.angular = turning;
    const SpatialInertia<T> y = inertia_at_point(tree, link);
    s.w = {a.linear * y.mass + (math::cross(a.angular, y.moment) +
                                math::cross(turning, math::cross(turning, y.moment))),
           math::cross(y.moment, a.linear) + (math::rotational(y, a.angular) +
                                              math::cross(turning, math::rotational(y, turning)))};
    const SpatialVector<T> wrench = {math::rotate_inverse(s.q, s.wrench.linear),
                                     math::rotate_inverse(s.q, s.wrench.angular)};
    const Vec3<T> com = link.body < 0 ? Vec3<T>{} : tree.com[link.body] - link_point(tree, link);
    s.w = s.w - SpatialVector<T>{wrench.linear, wrench.angular + math::cross(com, wrench.linear)};
  }
}

// Solves ID(q, qd, qdd) + diagonal qdd = ws.rhs for ws.qdd, where ID is inverse dynamics. The first
// solution starts from qdd = 0; the residual of inverse dynamics gives one correction. A dof with
// infinite diagonal keeps its qdd. Dofs of KINEMATIC joints have no acceleration.
template <class T>
NOVAPHY_LONG_TREES void accelerate_links(const Tree<T>& tree, const T* qd, Workspace<T>& ws) {
  const T o = T(0.0f), endless = T(math::bits_float(0x7f800000));
  const auto moves = [&](int32_t k) { return ws.diagonal[k] < endless; };
  for (int32_t k = 0; k < tree.dof_count; ++k) ws.qdd[k] = select(moves(k), o, ws.qdd[k]);
  for (int32_t i = 0; i < tree.link_count; ++i)
    for (int32_t j = 0; is_kinematic(tree.links[i]) && j < 6; ++j)
      ws.qdd[local_dof(tree, tree.links[i]) + j] = o;
  T* const more = articulated_corrections(tree, ws);
  for (int round = 0; round < 2; ++round) {
    link_forces(tree, qd, ws);
    for (int32_t k = 0; k < tree.dof_count; ++k)
      more[k] = select(moves(k), ws.rhs[k] - ws.diagonal[k] * ws.qdd[k], o);
    sweep_links(tree, ws, more);
    for (int32_t k = 0; k < tree.dof_count; ++k) ws.qdd[k] = ws.qdd[k] + more[k];
  }
}

}  // namespace novaphy::articulation
