// Shapes of one mechanism that overlap where its bodies start: contacts that push for ever.
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
  float depth;             // m: the deepest row of the pair
};

// The pairs in rigid contacts, on the CPU, of bodies that joints join, directly or by others, and
// that are to each other as in Model::body_q: those whose surfaces overlap by more than a hundredth
// of the smaller shape's collision radius; the deepest one first.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(const Model& model,
                                                              const SimState& state,
                                                              const Contacts& contacts);
// Those of the state that the model, on the CPU, starts with. Errors as of CollisionPipeline.
NOVAPHY_COLLISION_API std::vector<ShapeOverlap> find_overlaps(std::shared_ptr<const Model> model);

// "2 pairs of shapes overlap at the start: "a" and "b" by 0.012 m, ...": the first five pairs by
// the labels of the shapes, of worlds alike one, and how many others there are.
NOVAPHY_COLLISION_API std::string overlap_text(const Model& model,
                                               std::span<const ShapeOverlap> overlaps);

}  // namespace novaphy
