// Shapes that overlap where the bodies of a model start.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

struct ShapeOverlap {
  int32_t shape0, shape1;  // shape0 < shape1
  float depth;             // m: the deepest row of the pair
};

// The pairs of Model::shape_contact_pairs whose surfaces overlap at Model::body_q by more than a
// thousandth of the smaller shape's collision radius, the deepest one first. Left out are pairs of
// which neither shape moves: world-owned, of a kinematic body, or fixed to such a one by joints.
// Errors as of CollisionPipeline.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(
    const std::shared_ptr<const Model>& model);

// "2 pairs of shapes overlap at the start: 3 ("a") and 7 ("b") by 0.012 m, ..." Names the first
// pairs, by the labels of `model`.
NOVAPHY_COLLISION_API std::string overlap_text(const Model& model,
                                               const std::vector<ShapeOverlap>& overlaps);

}  // namespace novaphy
