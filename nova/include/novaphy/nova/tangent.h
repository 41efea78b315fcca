// Generates tangents (forward mode): from the Program of a kernel, the Program that propagates
// tangents of the sources to the outputs, in the same instruction set. The tangent of a gather is a
// gather, and the tangent of an ordered sum is the ordered sum of the tangents. Tangents and
// adjoints share the derivative rules, so <J u, w> = <u, J^T w> up to rounding.
#pragma once

#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

struct TangentPlan {
  // Sources: those of the kernel, then the tangents of `wrt` in order, each with the access of its
  // source. Outputs: the tangents of the kernel's outputs. Parameters and loops are those of the
  // kernel.
  ir::Program program;
  std::vector<bool> loads_value;  // per source: whether its value is read
};

// Makes the tangent of a Program, which must still contain PARTIAL and DETACH. `wrt`: per source,
// whether it has a tangent; other tangents are 0. ErrorKind::Value: an integer source has a
// tangent.
NOVAPHY_NOVA_API TangentPlan make_tangent(const ir::Program& program, const std::vector<bool>& wrt);

}  // namespace nova
