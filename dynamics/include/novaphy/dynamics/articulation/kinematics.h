// Forward kinematics: frames and motions of the links, and the update of q over a step. tree.h has
// the conventions.
#pragma once

#include "novaphy/dynamics/articulation/joints/joints.h"

namespace novaphy::articulation {

// Returns the joint's transform X_j(q) with a normalized quaternion. `length`: the quaternion's
// length before.
template <class T>
Transform<T> joint_transform(const Tree<T>& tree, const Link& link, const T* q, T& length) {
  Transform<T> x;
  Joints::visit(link.joint, [&](auto joint) { x = joint.transform(tree, link, q, length); });
  return x;
}

// Returns the inertia of a link about O, in world axes (R I R^T for the body's rotation R). c: the
// body's center of mass about O.
template <class T>
SpatialInertia<T> world_inertia(const Tree<T>& tree, const Link& link, const Quat<T>& q,
                                const Vec3<T>& c) {
  if (link.body < 0) return {};
  const Mat33<T>& i = tree.inertia[link.body];
  const T half = T(0.5f);
  const T xy = (i.m[0][1] + i.m[1][0]) * half, xz = (i.m[0][2] + i.m[2][0]) * half,
          yz = (i.m[1][2] + i.m[2][1]) * half;
  const Vec3<T> x = math::rotate(q, unit_vector<T>(0)), y = math::rotate(q, unit_vector<T>(1)),
                z = math::rotate(q, unit_vector<T>(2));
  // R I, column by column, times the rows of R.
  const Vec3<T> a = x * i.m[0][0] + (y * xy + z * xz), b = x * xy + (y * i.m[1][1] + z * yz),
                d = x * xz + (y * yz + z * i.m[2][2]);
  const auto entry = [&](T Vec3<T>::*r, T Vec3<T>::*s) {
    return (a.*r * x.*s + b.*r * y.*s) + d.*r * z.*s;
  };
  constexpr T Vec3<T>::*X = &Vec3<T>::x, Vec3<T>::*Y = &Vec3<T>::y, Vec3<T>::*Z = &Vec3<T>::z;
  return math::inertia_at(
      SpatialInertia<T>{tree.mass[link.body], Vec3<T>{T(0.0f), T(0.0f), T(0.0f)}, entry(X, X),
                        entry(Y, Y), entry(Z, Z), entry(X, Y), entry(X, Z), entry(Y, Z)},
      -c);
}

// Computes the columns of S for a link. The frames of the link must be up to date.
template <class T>
void set_axes(const Tree<T>& tree, const Link& link, const LinkState<T>& s,
              SpatialVector<T>* axes) {
  SpatialVector<T>* const column = axes + local_dof(tree, link);
  Joints::visit(link.joint, [&](auto joint) { joint.set_axes(tree, link, s, column); });
}

// Computes a link's frames from its parent's (null: the world) and q (indexed as in the model's
// arrays).
template <class T>
void link_frame(const Tree<T>& tree, const Link& link, const LinkState<T>* parent, const T* q,
                LinkState<T>& s) {
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  const Transform<T> x_p = link.frame_p < 0 ? Transform<T>::identity() : tree.X_p[link.frame_p];
  const Transform<T> x_j = joint_transform(tree, link, q + link.coord, s.quat_length);
  const Transform<T> x_c = link.frame_c < 0 ? Transform<T>::identity() : tree.X_c[link.frame_c];
  const Vec3<T> com = link.body < 0 ? none : tree.com[link.body];
  s.anchor_q = parent ? math::multiply(parent->q, x_p.q) : x_p.q;
  const Quat<T> joint_q = math::multiply(s.anchor_q, x_j.q);
  s.q = math::multiply(joint_q, math::conjugate(x_c.q));
  const Vec3<T> along = math::rotate(s.anchor_q, x_j.p) - math::rotate(s.q, x_c.p);
  const Vec3<T> c = math::rotate(s.q, com);
  if (parent) {
    s.origin = parent->origin;
    s.anchor_p = parent->p + math::rotate(parent->q, x_p.p);
    s.p = s.anchor_p + along;
  } else if (is_free(link)) {
    s.origin = x_p.p + (along + c);
    s.anchor_p = -(along + c);
    s.p = -c;
  } else {
    s.origin = x_p.p;
    s.anchor_p = none;
    s.p = along;
  }
  s.com = s.p + c;
  if (!parent && is_free(link)) s.com = none;
}

// Computes the frames and axes of all links.
template <class T>
void link_frames(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const LinkState<T>* parent = link.parent < 0 ? nullptr : &ws.links[link.parent];
    link_frame(tree, link, parent, q, ws.links[i]);
    set_axes(tree, link, ws.links[i], ws.axes);
  }
}

// Computes the frames, the axes and the inertias of all links.
template <class T>
void kinematics(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  link_frames(tree, q, ws);
  for (int32_t i = 0; i < tree.link_count; ++i)
    ws.links[i].inertia = world_inertia(tree, tree.links[i], ws.links[i].q, ws.links[i].com);
}

// Computes the motions of all links from qd (indexed by the tree's dofs).
template <class T>
void link_motions(const Tree<T>& tree, const T* qd, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const SpatialVector<T> v = joint_motion(tree, link, ws.axes, qd);
    ws.links[i].v = link.parent < 0 ? v : ws.links[link.parent].v + v;
  }
}

// Writes body_q and body_qd of a body, after link_frames and link_motions.
template <class T>
void write_body(int32_t body, const LinkState<T>& s, Transform<T>* body_q,
                SpatialVector<T>* body_qd) {
  body_q[body] = {s.origin + s.p, s.q};
  body_qd[body] = math::motion_at(s.v, s.com);
}
template <class T>
void write_bodies(const Tree<T>& tree, const Workspace<T>& ws, Transform<T>* body_q,
                  SpatialVector<T>* body_qd) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const int32_t body = tree.links[i].body;
    if (body >= 0) write_body(body, ws.links[i], body_q, body_qd);
  }
}

// Computes q_next from q after a time dt with the rates qd (indexed by the tree's dofs).
// Quaternions are normalized.
template <class T>
void integrate_coordinates(const Tree<T>& tree, const T* q, const T* qd, const T& dt, T* q_next) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const T* const u = qd + local_dof(tree, link);
    Joints::visit(link.joint, [&](auto joint) {
      joint.integrate(tree, link, q + link.coord, u, dt, q_next + link.coord);
    });
  }
}

}  // namespace novaphy::articulation
