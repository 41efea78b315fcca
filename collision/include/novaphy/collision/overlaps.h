// Finds shapes of one mechanism that overlap at the initial pose of its bodies. Their contacts
// would push forever.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

struct ShapeOverlap {
  int32_t shape0, shape1;  // shape0 < shape1
  float depth;             // m, of the deepest row of the pair
};

// Returns the overlapping pairs in rigid contacts, on the CPU, deepest first. The bodies of a pair
// are connected by joints, directly or through other bodies, and have the relative pose of
// Model::body_q. Their surfaces overlap by more than a hundredth of the smaller shape's collision
// radius.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(const Model& model,
                                                              const SimState& state,
                                                              const Contacts& contacts);
// Returns the overlaps in the initial state of a model on the CPU. Errors as for CollisionPipeline.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(std::shared_ptr<const Model> model);

// Returns a text such as "2 pairs of shapes overlap at the start: "a" and "b" by 0.012 m, ...". The
// text lists the first five pairs by the labels of their shapes, counts equal pairs of several
// worlds once, and gives the number of the others.
NOVAPHY_COLLISION_API std::string overlap_text(const Model& model,
                                               std::span<const ShapeOverlap> overlaps);

}  // namespace novaphy
