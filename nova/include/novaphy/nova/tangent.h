// Tangents: from the Program of a kernel to the Program that pushes tangents of its sources forward
// to its outputs (forward mode). The instruction set is closed under this: the tangent of a gather
// is a gather, of an ordered sum the ordered sum of the tangents. Tangents share the derivative
// rules with adjoints, so <J u, w> = <u, J^T w> up to rounding.
#pragma once

#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

struct TangentPlan {
  // Sources: those of the kernel, then the tangents of `wrt` in order, each read like its source.
  // Outputs: the tangents of the kernel's outputs. Parameters and loops: those of the kernel.
  ir::Program program;
  std::vector<bool> loads_value;  // per source: its value is read
};

// `program` still carries PARTIAL and DETACH. `wrt`, per source: it has a tangent; those of all
// others are 0. Throws ErrorKind::Value for an integer source.
NOVAPHY_NOVA_API TangentPlan make_tangent(const ir::Program& program, const std::vector<bool>& wrt);

}  // namespace nova
