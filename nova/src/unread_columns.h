// Internal: finds the columns of a gradient that an adjoint does not read.
#pragma once

#include <cstddef>
#include <cstdint>

#include "novaphy/nova/adjoint.h"

namespace nova {

// Returns, as bits, the columns of an output's gradient on which the gradients of the requested
// sources do not depend.
uint32_t unread_columns(const ir::Program& program, size_t output, const AdjointMask& mask);

}  // namespace nova
