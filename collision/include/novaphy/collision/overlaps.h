// Finds shapes of one mechanism that overlap in the initial pose of its bodies. The contacts of
// these shapes would push all the time.
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
  float depth;             // m, largest overlap of the rows of the pair
};

// Returns the overlapping pairs in the rigid contacts of a state on the CPU, deepest first. A pair
// is listed if its bodies are connected by joints, directly or through other bodies, and have the
// relative pose of Model::body_q. The overlap must also exceed a hundredth of the smaller shape's
// collision radius.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(const Model& model,
                                                              const SimState& state,
                                                              const Contacts& contacts);
// Returns the overlaps in the initial state of a model on the CPU. Errors as for CollisionPipeline.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(std::shared_ptr<const Model> model);

// Returns a text such as "2 pairs of shapes overlap at the start: "a" and "b" by 0.012 m, ...". The
// text lists the first five pairs by the labels of their shapes, and the number of the remaining
// pairs. Equal pairs of several worlds count once.
NOVAPHY_COLLISION_API std::string overlap_text(const Model& model,
                                               std::span<const ShapeOverlap> overlaps);

}  // namespace novaphy
