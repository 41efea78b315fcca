#include "stick_springs.h"

#include <utility>

#include "novaphy/math/functions.h"

namespace novaphy {

void StickSprings::begin(const Contacts& c, int32_t rows, const Array& body_q) {
  std::swap(points_, before_);
  if (!last_.matches(body_q)) before_.clear();
  points_.resize(static_cast<size_t>(rows));
  const int32_t *const shape0 = c.rigid_contact_shape0.data(),
                       *const shape1 = c.rigid_contact_shape1.data(),
                       *const id = c.rigid_contact_point_id.data();
  // The rows of this step and of the step before are both sorted by their shapes.
  size_t pair = 0;
  for (size_t row = 0; row < points_.size(); ++row) {
    Point& point = points_[row] = {shape0[row], shape1[row], id[row], {}};
    const auto shapes = std::pair(point.shape0, point.shape1);
    const auto of = [&](size_t k) { return std::pair(before_[k].shape0, before_[k].shape1); };
    while (pair < before_.size() && of(pair) < shapes) ++pair;
    for (size_t k = pair; k < before_.size() && of(k) == shapes; ++k)
      if (before_[k].id == point.id) point.slip = before_[k].slip;
  }
}

Vec3f StickSprings::friction(int64_t row, const Vec3f& normal, const Vec3f& ut, float limit,
                             float kf, float ke, float dt) {
  Vec3f& slip = points_[static_cast<size_t>(row)].slip;
  if (!(limit > 0.0f)) {
    slip = {};
    return {};
  }
  slip = (slip - normal * math::dot(normal, slip)) + ut * dt;
  const Vec3f f = slip * ke + ut * kf;
  const float size = math::length(f);
  if (!(size > limit)) return f;
  const Vec3f held = f * (limit / size);
  slip = held * (1.0f / ke);
  return held;
}

void StickSprings::end(const Array& body_q) { last_.set(body_q); }

}  // namespace novaphy
