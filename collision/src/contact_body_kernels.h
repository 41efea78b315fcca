// A kernel that finds the bodies of the shapes of contacts.
#pragma once

#include "novaphy/core/row_kernel.h"

namespace novaphy {

struct ContactBodyArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> shape0;         // shape of each contact; -1: none
                    Optional<Reads<int32_t>> shape1;  // null: contacts have one shape only
                    Reads<int32_t> shape_body; Number<int64_t> shapes;
                    Writes<int32_t> bodies;  // for each contact: one body or two
  )
};
// Writes the bodies of contact `row`; -1 for a shape of the world and for a missing shape.
NOVAPHY_ROW_KERNEL(contact_body, ContactBodyArguments) {
  const auto body_of = [&](int32_t shape) {
    return shape >= 0 && shape < a.shapes ? a.shape_body[shape] : -1;
  };
  const int64_t columns = a.shape1 == nullptr ? 1 : 2;
  a.bodies[row * columns] = body_of(a.shape0[row]);
  if (columns == 2) a.bodies[row * columns + 1] = body_of(a.shape1[row]);
}

}  // namespace novaphy
