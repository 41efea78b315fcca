// The arrays that a step of trees reads: the one list of which arguments of kernels, gradients,
// lanes, dual numbers, launches and names in messages are made.
//
// A says what a field is. ReadPointers, WritePointers: a pointer to the array. GivenArrays,
// WantedArrays (arguments.h): an argument of kernels. Each: a thing of the same type for every
// array, as its place in the list. StepShape: the array's rows and width.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/tree.h"
#include "novaphy/math/matrix.h"

namespace novaphy::articulation {

// What an array has a row for.
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
// Calls visit(field of each of `a`...) for every array. This order is that of the members.
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

// Arrays without one.
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

// What a step reads; null where an algorithm does not look.
template <class T>
struct StepInputs : StepArrays<ReadPointers<T>> {
  const int32_t* target_mode;  // JointTargetMode
};
template <class T>
struct StepOptions {
  T dt{};               // s
  T angular_damping{};  // 1/s
  bool implicit_drives = true;
};

// Where gradients go; null: nobody wants it. `add`: bit i for the i-th array, to what is there;
// else they are stored.
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
