// Corrects common deviations of URDF files from the format.
#pragma once

#include <set>

#include "../robot/notes.h"

namespace novaphy::detail {

struct MendedUrdf {
  std::set<const Element*> capsules;  // <cylinder> elements that were <capsule> elements
};

// Corrects the elements of the file, and notes each correction.
MendedUrdf mend_urdf(XmlFile& file, Notes& notes);

}  // namespace novaphy::detail
