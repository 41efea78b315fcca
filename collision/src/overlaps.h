// Internal: find_overlaps of the candidates of a pipeline.
#pragma once

#include <memory>
#include <vector>

#include "novaphy/collision/overlaps.h"
#include "rigid_contacts.h"

namespace novaphy::detail {

// `search` is used once; nothing of it is recorded.
std::vector<ShapeOverlap> find_overlaps(const Model& model, RigidContacts& search);

}  // namespace novaphy::detail
