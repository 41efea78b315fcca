// Shapes that overlap where the bodies of a model start.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {

struct ShapeOverlap {
  int32_t shape0, shape1;  // shape0 < shape1
  float depth;             // m: the deepest row of the pair
  std::string label0, label1;
};

// The pairs of these shapes of a builder that may meet and whose surfaces overlap, where the bodies
// start, by more than a thousandth of the smaller shape's collision radius; the deepest one first.
// Builds the tables of those shapes only whose boxes meet. ErrorKind::Index: no such shape;
// otherwise errors as of CollisionPipeline.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(const ModelBuilder& builder,
                                                              std::vector<int32_t> shapes);

// "2 pairs of shapes overlap at the start: "a" and "b" by 0.012 m, ...", with the first three pairs
// by the labels of the shapes.
NOVAPHY_COLLISION_API std::string overlap_text(std::span<const ShapeOverlap> overlaps);

}  // namespace novaphy
