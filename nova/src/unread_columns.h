// Internal: which columns of a gradient an adjoint leaves unread.
#pragma once

#include <cstddef>
#include <cstdint>

#include "novaphy/nova/adjoint.h"

namespace nova {

// The columns, as bits, of an output's gradient from which nothing flows to the wanted sources.
uint32_t unread_columns(const ir::Program& program, size_t output, const AdjointMask& mask);

}  // namespace nova
