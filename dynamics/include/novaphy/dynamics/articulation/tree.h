// Articulated trees: the description of a tree, and the memory of its algorithms. Templates over
// the scalar (float, double, Dual<float>, SIMD lanes of floats with a tree per lane), freestanding,
// without allocation.
//
// A tree has links. One joint connects link i to its parent link, which has a smaller index (parent
// -1: the world). A joint of type D6 becomes a chain of links, all massless except the last:
// prismatic along its linear axes, then revolute about its angular axes. Several links may have the
// parent -1 (roots).
//
// Frames. The anchor X_wpj = X_parent X_p is the joint's frame in the parent. The body's frame is X
// = X_wpj X_j(q) X_c^-1. Every root has its own origin O: the anchor, or the center of mass of a
// FREE root. All positions, motions (v, w) and forces (f, t) of the tree are relative to O, in
// world axes. Only O depends on the world's origin.
//
// Velocities. The joint's motion is S qd. The columns of S do not rotate with the joint's own q:
//   PRISMATIC  (R a, 0)                REVOLUTE  (p x R a, R a)        BALL  (p x R e_k, R e_k)
//   FREE       (R e_k, 0), then (c x R e_k, R e_k)
// with the anchor's rotation R and position p and the body's center of mass c. The qd of a BALL
// joint is therefore the angular velocity in the anchor's axes. The qd of a FREE joint is the
// velocity of the center of mass and the angular velocity, relative to the anchor, in the anchor's
// axes.
//
// Tangents of q have one number per dof. For a tangent e, a BALL joint rotates by exp(e) on the
// left. A FREE joint moves the center of mass by e_linear and rotates the body by exp(e_angular)
// about it. For all joints, dX = S e.
// Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 4 to 6.
#pragma once

#include "novaphy/dynamics/articulation/scalar.h"
#include "novaphy/math/spatial.h"

namespace novaphy::articulation {

// The joint type of a link. The values are those of JointType. Kinematic: a FREE joint with
// prescribed rates.
enum class LinkJoint : int32_t {
  Prismatic = 0,
  Revolute = 1,
  Ball = 2,
  Fixed = 3,
  Free = 4,
  Kinematic = 7
};

struct Link {
  LinkJoint joint = LinkJoint::Fixed;
  int32_t parent = -1;   // parent link
  int32_t frame_p = -1;  // row of X_p; -1: identity
  int32_t frame_c = -1;  // row of X_c; -1: identity
  int32_t body = -1;     // row of mass, com, inertia, wrenches, body_q and body_qd; -1: no mass
  int32_t coord = 0;     // first row of q
  int32_t dof = 0;       // first row of qd, and of the axis
  int32_t dofs = 0;
  int32_t leader = -1;                     // leader of a mimic joint (mimic.h), which is no mimic
                                           // joint itself; -1: none
  float multiplier = 1.0f, offset = 0.0f;  // relation to the leader's coordinate
  bool operator==(const Link&) const = default;
};

// A tree. Rows are those of the model's arrays, which several trees may share. Quaternions of X_p
// and X_c have unit length.
template <class T>
struct Tree {
  int32_t link_count = 0, dof_count = 0;
  const Link* links = nullptr;          // {link_count}
  const int32_t* dof_parent = nullptr;  // {dof_count}: the next dof towards the root; -1: none.
                                        // Both are counted from the tree's first dof.
  int32_t first_dof = 0;                // row of dof 0
  const Transform<T>*X_p = nullptr, *X_c = nullptr;
  const Vec3<T>* axis = nullptr;      // unit vector
  const T* mass = nullptr;            // kg
  const Vec3<T>* com = nullptr;       // m, body frame
  const Mat33<T>* inertia = nullptr;  // kg m^2 about the center of mass, body axes; its symmetric
                                      // part is used
  Vec3<T> gravity = {};               // m/s^2
  int32_t mimics = 0;                 // number of mimic links
  int32_t joints_in_a_row = 0;        // largest number of moving joints from a root to a leaf
};
// Trees with more moving joints in a row than this have no mass matrix (factor.h).
inline constexpr int32_t kMatrixJoints = 9;

// The results of kinematics, inverse_dynamics and mass_matrix for a link.
template <class T>
struct LinkState {
  Quat<T> anchor_q{};             // rotation of X_wpj
  Vec3<T> anchor_p{};             // m, about O
  Quat<T> q{};                    // rotation of the body's frame
  Vec3<T> p{};                    // m, origin of the body's frame, about O
  Vec3<T> com{};                  // m, about O
  Vec3<T> origin{};               // O in the world frame
  T quat_length = T(1.0f);        // length of the joint's quaternion coordinates; BALL and FREE
  SpatialInertia<T> inertia{};    // about O
  SpatialInertia<T> composite{};  // of the link with its descendants
  SpatialVector<T> v{};           // motion of the link
  SpatialVector<T> a{};           // acceleration of the link, minus gravity
  SpatialVector<T> f{};           // force through the joint
  SpatialVector<T> wrench{};      // external wrench about the link's center of mass, world axes
  // Data of adjoint sweeps: virtual motion, adjoints of acceleration and motion, torque of
  // wrenches. The sweeps of articulated_body.h also use this memory.
  SpatialVector<T> w{}, a_adjoint{}, v_adjoint{};
  Vec3<T> wrench_torque{};
};

// The memory of the algorithms for a tree with n dofs. `links` has link_count rows, and `matrix`
// has {n, n} entries. Other arrays have n rows.
template <class T>
struct Workspace {
  LinkState<T>* links = nullptr;
  SpatialVector<T>* axes = nullptr;  // S
  T* matrix = nullptr;               // lower triangle: H, or a factor (factor.h)
  T* diagonal = nullptr;             // terms added to H's diagonal
  T* cone = nullptr;  // for BALL limits: c of the term c c^T in H
  T *bias = nullptr, *qdd = nullptr, *qd_next = nullptr, *rhs = nullptr, *given = nullptr;
  T* shift = nullptr;             // shifts of contacts (pgs.h), added to qd_next; null: no shifts
  Branches<T>* branch = nullptr;  // bits of Branch (limits.h)
};

// Returns the size of the matrix, or of the data of articulated_body.h in its place, in numbers.
inline int64_t matrix_numbers(int32_t links, int32_t dofs) {
  const int64_t n = dofs, matrix = n * n, rows = int64_t{12} * links + 11 * n;
  return dofs > kMatrixJoints && matrix < rows ? rows : matrix;
}
// Returns the size of a workspace, a multiple of 8 bytes. The memory must be aligned to 8 bytes, or
// to the SIMD lane type.
template <class T>
int64_t workspace_bytes(int32_t links, int32_t dofs) {
  const int64_t n = dofs, ints = (n * static_cast<int64_t>(sizeof(Branches<T>)) + 7) / 8 * 8;
  return links * static_cast<int64_t>(sizeof(LinkState<T>)) +
         n * static_cast<int64_t>(sizeof(SpatialVector<T>)) +
         ((matrix_numbers(links, dofs) + 7 * n) * static_cast<int64_t>(sizeof(T)) + 7) / 8 * 8 +
         ints + 8;
}
template <class T>
Workspace<T> make_workspace(void* memory, int32_t links, int32_t dofs) {
  Workspace<T> ws;
  const int64_t n = dofs;
  ws.links = static_cast<LinkState<T>*>(memory);
  ws.axes = reinterpret_cast<SpatialVector<T>*>(ws.links + links);
  ws.matrix = reinterpret_cast<T*>(ws.axes + n);
  ws.diagonal = ws.matrix + matrix_numbers(links, dofs);
  ws.cone = ws.diagonal + n;
  ws.bias = ws.cone + n;
  ws.qdd = ws.bias + n;
  ws.qd_next = ws.qdd + n;
  ws.rhs = ws.qd_next + n;
  ws.given = ws.rhs + n;
  ws.branch = reinterpret_cast<Branches<T>*>(ws.given + n);
  return ws;
}

// Returns the first dof of a link, counted from the tree's first dof.
template <class T>
int32_t local_dof(const Tree<T>& tree, const Link& link) {
  return link.dof - tree.first_dof;
}
template <class T>
SpatialVector<T> zero_spatial() {
  return {{T(0.0f), T(0.0f), T(0.0f)}, {T(0.0f), T(0.0f), T(0.0f)}};
}
template <class T>
Vec3<T> unit_vector(int k) {
  return {T(k == 0 ? 1.0f : 0.0f), T(k == 1 ? 1.0f : 0.0f), T(k == 2 ? 1.0f : 0.0f)};
}
template <class T>
SpatialVector<T> operator-(const SpatialVector<T>& a) {
  return {-a.linear, -a.angular};
}
// Returns the sum of S_k x_k over a link's dofs.
template <class T>
SpatialVector<T> joint_motion(const Tree<T>& tree, const Link& link, const SpatialVector<T>* axes,
                              const T* x) {
  const int32_t first = local_dof(tree, link);
  SpatialVector<T> sum = zero_spatial<T>();
  for (int32_t k = first; k < first + link.dofs; ++k) sum = sum + axes[k] * x[k];
  return sum;
}
// Returns the world axes' components of a vector x {3} given in an anchor's axes.
template <class T>
Vec3<T> turned(const Quat<T>& q, const T* x) {
  return math::rotate(q, Vec3<T>{x[0], x[1], x[2]});
}

}  // namespace novaphy::articulation
