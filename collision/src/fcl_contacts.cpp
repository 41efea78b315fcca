#include "fcl_contacts.h"

#include "rigid_contact_kernels.h"

namespace novaphy::detail {

void FclContacts::use_tables(uint64_t version) {
  if (version_ == version) return;
  hulls_.clear();
  version_ = version;
}

const FclHull& FclContacts::hull_of(const RigidShape& shape) {
  const auto at = hulls_.find(shape.geometry);
  return at != hulls_.end()
             ? at->second
             : hulls_.emplace(shape.geometry, FclHull(shape.geometry->hull)).first->second;
}

int32_t FclContacts::query(const RigidShape& s0, const RigidShape& s1, int32_t count,
                           int32_t per_pair, geometry::Manifold& kept) {
  using namespace geometry;
  const Transformf relative = relative_pose(s0.pose, s1.pose);
  const Shape a = convex_shape(s0), b = convex_shape(s1);  // `pair` points to both shapes
  const ShapePair pair = shape_pair(a, b, relative);
  if (!is_finite(pair)) return count;
  float deepest = 0.0f;
  for (int32_t i = 0; i < count; ++i) deepest = math::min(deepest, kept.points[i].distance);
  const auto found = hull_of(s0).penetration(hull_of(s1), relative);
  if (!found && deepest >= 0.0f) return count;  // both methods find no overlap
  ++pairs_;
  constexpr float kTolerance = 1e-4f;  // of the size of the pair
  const auto size = [](const RigidShape& s) {
    return math::length(s.geometry->box.hi - s.geometry->box.lo);
  };
  const float tolerance = kTolerance * (size(s0) + size(s1));
  const float depth = found ? static_cast<float>(found->depth) : 0.0f;
  const Vec3f n = found ? found->normal : Vec3f{};
  // This form of the comparisons excludes NaN.
  const bool good = found && math::abs(math::length(n) - 1.0f) <= 1e-3f &&
                    math::abs(separation_along(pair, n) + depth) <= tolerance &&
                    math::abs(depth + deepest) <= tolerance;
  if (!good) {
    ++fallbacks_;
    return count;
  }
  const Vec3f on_b = support_point(pair, n).b;
  const Proximity proximity{n, -depth, on_b + n * depth, on_b};
  keep_rows(s0, s1, in_frame(clip_manifold(pair, proximity, reach_of(s0, s1)), s0.pose), per_pair,
            kept);
  return kept.count;
}

}  // namespace novaphy::detail
