// The tangent of a moving contact point of trees, from the tangents of the two bodies' poses
// (turning_contacts.h).
#pragma once

#include "novaphy/dynamics/articulation/dual.h"
#include "novaphy/dynamics/articulation/turning_contacts.h"

namespace novaphy::articulation {

inline Vec3f tangent(const Vec3<DualFloat>& v) { return {v.x.tangent, v.y.tangent, v.z.tangent}; }
inline void set_tangent(const Vec3f& to, Vec3<DualFloat>& v) {
  v.x.tangent = to.x;
  v.y.tangent = to.y;
  v.z.tangent = to.z;
}
inline Vec3f value_of(const Vec3<DualFloat>& v) { return {v.x.value, v.y.value, v.z.value}; }
inline Transformf value_of(const Transform<DualFloat>& x) {
  return {value_of(x.p), {x.q.x.value, x.q.y.value, x.q.z.value, x.q.w.value}};
}

// Returns the tangent of a pose as a twist at the point `at`.
inline SpatialVectorf twist_of(const Transform<DualFloat>& pose, const Vec3f& at) {
  const Transformf x = value_of(pose);
  const Quatf speed = {pose.q.x.tangent, pose.q.y.tangent, pose.q.z.tangent, pose.q.w.tangent};
  const Quatf half = math::multiply(speed, math::conjugate(x.q));
  SpatialVectorf to;
  to.angular = {2.0f * half.x, 2.0f * half.y, 2.0f * half.z};
  to.linear = tangent(pose.p) + math::cross(to.angular, at - x.p);
  return to;
}

// The normal of a contact, and the motion of its surface points in the world, as dual numbers.
struct DualTurning {
  bool is_exact = false;
  Vec3<DualFloat> normal{};
  Vec3f moved[2] = {};
  Vec3f about{};
  Transform<DualFloat> pose[2] = {};  // of the bodies, relative to `about`

  // Finds the normal and the motion. `of`: the contact at the values of the poses. Margins in m.
  void find(const TurningShapes& shapes, const TurningInput<float>& of, float margin0,
            float margin1) {
    const float margins[2] = {margin0, -margin1};
    Vec3f points[2];
    for (int side = 0; side < 2; ++side)
      points[side] =
          math::transform_point(of.pose[side], of.point[side]) + of.normal * margins[side];
    const Vec3f apart = points[1] - points[0], at = points[0] + apart * 0.5f;
    const SpatialVectorf of_a = twist_of(pose[0], at), of_b = twist_of(pose[1], at);
    const SpatialVectorf relative[1] = {{of_b.linear - of_a.linear, of_b.angular - of_a.angular}};
    const Turning<1> turning = turning_along(shapes, of, margins, at, relative);
    is_exact = turning.is_exact;
    if (!is_exact) return;
    const Vec3f turned = math::cross(of_a.angular, of.normal);
    const Vec3f half = turned * (0.5f * math::dot(apart, of.normal));
    normal = constant(of.normal);
    set_tangent(turned + turning.normal[0], normal);
    moved[0] = of_a.linear - half + turning.a[0];
    moved[1] = of_a.linear + half + turning.b[0];
  }
};

}  // namespace novaphy::articulation
