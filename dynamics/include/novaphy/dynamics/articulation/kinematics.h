// Where the links are, and how they move: forward kinematics, the update of q, and the adjoint of
// both. Conventions: tree.h.
#pragma once

#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

template <class T>
T quat_length(const Quat<T>& q) {
  return square_root(((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w);
}
template <class T>
Quat<T> scaled(const Quat<T>& q, const T& s) {
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}

// X_j(q), with a quaternion of any length made unit; `length` is what it had.
template <class T>
Transform<T> joint_transform(const Tree<T>& tree, const Link& link, const T* q, T& length) {
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  switch (link.joint) {
    case LinkJoint::Prismatic:
      return {tree.axis[link.dof] * q[0], Quat<T>::identity()};
    case LinkJoint::Revolute: {
      const SinCos<T> half = sin_cos(T(0.5f) * q[0]);
      const Vec3<T> v = tree.axis[link.dof] * half.sin;
      return {none, {v.x, v.y, v.z, half.cos}};
    }
    case LinkJoint::Ball: {
      const Quat<T> r = {q[0], q[1], q[2], q[3]};
      length = quat_length(r);
      return {none, scaled(r, T(1.0f) / length)};
    }
    case LinkJoint::Free:
    case LinkJoint::Kinematic: {
      const Quat<T> r = {q[3], q[4], q[5], q[6]};
      length = quat_length(r);
      return {{q[0], q[1], q[2]}, scaled(r, T(1.0f) / length)};
    }
    default:
      return Transform<T>::identity();
  }
}

// R I R^T about O, of a body with its centre of mass at c.
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
  // R I by its columns, times the rows of R.
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

// The columns of S of a link whose frames are set.
template <class T>
void set_axes(const Tree<T>& tree, const Link& link, const LinkState<T>& s,
              SpatialVector<T>* axes) {
  const Vec3<T> none = {T(0.0f), T(0.0f), T(0.0f)};
  SpatialVector<T>* column = axes + local_dof(tree, link);
  const auto turn = [&](const Vec3<T>& axis, const Vec3<T>& at) {
    const Vec3<T> w = math::rotate(s.anchor_q, axis);
    return SpatialVector<T>{math::cross(at, w), w};
  };
  switch (link.joint) {
    case LinkJoint::Prismatic:
      column[0] = {math::rotate(s.anchor_q, tree.axis[link.dof]), none};
      break;
    case LinkJoint::Revolute:
      column[0] = turn(tree.axis[link.dof], s.anchor_p);
      break;
    case LinkJoint::Ball:
      for (int k = 0; k < 3; ++k) column[k] = turn(unit_vector<T>(k), s.anchor_p);
      break;
    case LinkJoint::Free:
    case LinkJoint::Kinematic:
      for (int k = 0; k < 3; ++k) {
        column[k + 3] = turn(unit_vector<T>(k), s.com);
        column[k] = {column[k + 3].angular, none};
      }
      break;
    default:
      break;
  }
}

// Frames of a link behind its parent's (null: the world), from q (rows of the arrays).
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

// Frames and axes of all links.
template <class T>
void link_frames(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const LinkState<T>* parent = link.parent < 0 ? nullptr : &ws.links[link.parent];
    link_frame(tree, link, parent, q, ws.links[i]);
    set_axes(tree, link, ws.links[i], ws.axes);
  }
}

// link_frames, and the inertias of all links.
template <class T>
void kinematics(const Tree<T>& tree, const T* q, Workspace<T>& ws) {
  link_frames(tree, q, ws);
  for (int32_t i = 0; i < tree.link_count; ++i)
    ws.links[i].inertia = world_inertia(tree, tree.links[i], ws.links[i].q, ws.links[i].com);
}

// Motions of the links, from qd (rows of the tree).
template <class T>
void link_motions(const Tree<T>& tree, const T* qd, Workspace<T>& ws) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const SpatialVector<T> v = joint_motion(tree, link, ws.axes, qd);
    ws.links[i].v = link.parent < 0 ? v : ws.links[link.parent].v + v;
  }
}

// body_q and body_qd (rows of the bodies), behind link_frames and link_motions.
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

// Where a link's centre of mass is in its joint's frame: X_c^-1 (com).
template <class T>
Vec3<T> com_in_joint(const Tree<T>& tree, const Link& link) {
  const Vec3<T> com = link.body < 0 ? Vec3<T>{} : tree.com[link.body];
  return link.frame_c < 0
             ? com
             : math::rotate_inverse(tree.X_c[link.frame_c].q, com - tree.X_c[link.frame_c].p);
}

// The unit quaternion of (y, 1): the rotation of a step, with y = dt w / 2.
template <class T>
Quat<T> cayley(const Vec3<T>& y) {
  const T s = T(1.0f) / square_root(T(1.0f) + math::dot(y, y));
  return {y.x * s, y.y * s, y.z * s, s};
}

// q after dt at the rates qd (rows of the tree). Quaternions come out unit.
template <class T>
void integrate_coordinates(const Tree<T>& tree, const T* q, const T* qd, const T& dt, T* q_next) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    const T* const x = q + link.coord;
    T* const y = q_next + link.coord;
    const T* const u = qd + local_dof(tree, link);
    if (link.joint == LinkJoint::Prismatic || link.joint == LinkJoint::Revolute) {
      y[0] = x[0] + dt * u[0];
    } else if (link.joint == LinkJoint::Ball || is_free(link)) {
      const bool free = is_free(link);
      const int32_t o = free ? 3 : 0;
      const Quat<T> raw = {x[o], x[o + 1], x[o + 2], x[o + 3]};
      const Quat<T> r = scaled(raw, T(1.0f) / quat_length(raw));
      const T h = T(0.5f) * dt;
      const Quat<T> turned =
          math::multiply(cayley(Vec3<T>{h * u[o], h * u[o + 1], h * u[o + 2]}), r);
      const Quat<T> next = scaled(turned, T(1.0f) / quat_length(turned));
      if (free) {
        const Vec3<T> rc = com_in_joint(tree, link);
        const Vec3<T> moved = math::rotate(r, rc) - math::rotate(next, rc);
        y[0] = x[0] + (dt * u[0] + moved.x);
        y[1] = x[1] + (dt * u[1] + moved.y);
        y[2] = x[2] + (dt * u[2] + moved.z);
      }
      y[o] = next.x;
      y[o + 1] = next.y;
      y[o + 2] = next.z;
      y[o + 3] = next.w;
    }
  }
}

}  // namespace novaphy::articulation
