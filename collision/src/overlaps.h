// Internal: the overlaps of a model's shapes.
#pragma once

#include <vector>

#include "novaphy/collision/overlaps.h"
#include "rigid_contacts.h"

namespace novaphy::detail {

// Those of the candidates of `search` at Model::body_q, as find_overlaps. Left out are shapes of
// the world, into which what rests on springs sinks, and pairs of which neither shape moves: of
// kinematic bodies, or fixed to such a one or the world by joints. Nothing is recorded.
std::vector<ShapeOverlap> overlaps_of(const Model& model, RigidContacts& search);

}  // namespace novaphy::detail
