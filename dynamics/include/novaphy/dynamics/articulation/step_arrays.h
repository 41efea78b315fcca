// The list of the arrays that a step of trees reads. Kernel arguments, gradients, SIMD lanes, dual
// numbers, launches and the names in error messages all follow this list.
//
// The template argument A selects the type of each field. ReadPointers, WritePointers: a pointer to
// the array. GivenArrays, WantedArrays (arguments.h): a kernel argument. Each: the same type for
// every array, for example its index in the list. StepShape: the rows and width of the array.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/tree.h"
#include "novaphy/math/matrix.h"

namespace novaphy::articulation {

// The kind of objects that the rows of an array belong to.
enum class RowOf : int32_t { Coord, Dof, Body, World, Joint };

// Arrays with a gradient.
template <class A>
struct GradientArrays {
  using T = typename A::Scalar;
  template <RowOf row, class Value>
  using Array = typename A::template Array<row, Value>;
  using PerDof = Array<RowOf::Dof, T>;

  NOVAPHY_ARGUMENTS(Array<RowOf::Coord, T> q; PerDof qd, joint_f;
                    Array<RowOf::Body, SpatialVector<T>> body_f; Array<RowOf::Coord, T> target_q;
                    PerDof target_qd, target_ke, target_kd, damping, armature, limit_lower,
                    limit_upper, limit_ke, limit_kd, effort_limit, velocity_limit;
                    Array<RowOf::Body, T> mass; Array<RowOf::Body, Vec3<T>> com;
                    Array<RowOf::Body, Mat33<T>> inertia; Array<RowOf::World, Vec3<T>> gravity;)
};
// Calls visit(field of each of `a`...) once per array, in the order of the members.
template <class Visit, class... Arrays>
constexpr void for_each_gradient_array(const Visit& visit, Arrays&... a) {
  visit(a.q...);
  visit(a.qd...);
  visit(a.joint_f...);
  visit(a.body_f...);
  visit(a.target_q...);
  visit(a.target_qd...);
  visit(a.target_ke...);
  visit(a.target_kd...);
  visit(a.damping...);
  visit(a.armature...);
  visit(a.limit_lower...);
  visit(a.limit_upper...);
  visit(a.limit_ke...);
  visit(a.limit_kd...);
  visit(a.effort_limit...);
  visit(a.velocity_limit...);
  visit(a.mass...);
  visit(a.com...);
  visit(a.inertia...);
  visit(a.gravity...);
}

// Arrays without a gradient.
template <class A>
struct FrameArrays {
  using T = typename A::Scalar;
  template <RowOf row, class Value>
  using Array = typename A::template Array<row, Value>;
  NOVAPHY_ARGUMENTS(Array<RowOf::Joint, Transform<T>> X_p, X_c; Array<RowOf::Dof, Vec3<T>> axis;)
};
template <class Visit, class... Arrays>
constexpr void for_each_frame_array(const Visit& visit, Arrays&... a) {
  visit(a.X_p...);
  visit(a.X_c...);
  visit(a.axis...);
}
template <class A>
struct StepArrays : GradientArrays<A>, FrameArrays<A> {};
template <class Visit, class... Arrays>
constexpr void for_each_array(const Visit& visit, Arrays&... a) {
  for_each_gradient_array(visit, a...);
  for_each_frame_array(visit, a...);
}

template <class T>
struct ReadPointers {
  using Scalar = T;
  template <RowOf, class Value>
  using Array = const Value*;
};
template <class T>
struct WritePointers {
  using Scalar = T;
  template <RowOf, class Value>
  using Array = Value*;
};
template <class X>
struct Each {
  using Scalar = float;
  template <RowOf, class>
  using Array = X;
};
struct StepShape {
  using Scalar = float;
  template <RowOf row, class Value>
  struct Array {
    static constexpr RowOf kRowOf = row;
    static constexpr int32_t kWidth = sizeof(Value) / sizeof(float);
  };
};

// The inputs of a step. An array is null if an algorithm does not need it.
template <class T>
struct StepInputs : StepArrays<ReadPointers<T>> {
  const int32_t* target_mode;  // JointTargetMode
};
template <class T>
struct StepOptions {
  T dt{};               // s
  T angular_damping{};  // 1/s
  bool implicit_drives = true;
  bool limit_rows = false;                         // limits are rows of rate_bounds.h
  T limit_restitution{}, restitution_threshold{};  // 1, m/s or rad/s
};

template <class To, class From>
StepOptions<To> options_as(const StepOptions<From>& o) {
  return {To(o.dt),     To(o.angular_damping),   o.implicit_drives,
          o.limit_rows, To(o.limit_restitution), To(o.restitution_threshold)};
}

// Gradients by the arrays. Null: not requested. `add`: bit i says that the i-th gradient is added
// to instead of stored.
template <class T>
struct StepGradient : GradientArrays<WritePointers<T>> {
  int32_t add;
};
template <class T>
Mat33<T> operator+(const Mat33<T>& a, const Mat33<T>& b) {
  return math::add(a, b);
}
template <class T, class Value>
void put(const StepGradient<T>& g, Value* GradientArrays<WritePointers<T>>::*array, int32_t row,
         const Value& value) {
  Value* const to = g.*array;
  if (to == nullptr) return;
  const auto place = reinterpret_cast<const char*>(&(g.*array)) - reinterpret_cast<const char*>(&g);
  const bool add = g.add >> (place / static_cast<int64_t>(sizeof(to))) & 1;
  to[row] = add ? to[row] + value : value;
}

template <class T>
void set_arrays(const StepInputs<T>& in, int32_t world, Tree<T>& tree) {
  tree.X_p = in.X_p;
  tree.X_c = in.X_c;
  tree.axis = in.axis;
  tree.mass = in.mass;
  tree.com = in.com;
  tree.inertia = in.inertia;
  tree.gravity = in.gravity[world];
}

}  // namespace novaphy::articulation
