// The sweeps of VBD (sweep_kernels.h) on the CPU, compiled for several instruction sets.
#pragma once

#include <cstdint>

namespace novaphy::vbd {

// A function over rows of a launch, with the signature of novaphy_row_function. A row is one lane
// of a group.
using GroupKernel = void(const uint64_t* words, int64_t n, int64_t begin, int64_t end);

struct SweepLevel {
  const char* name;
  int lanes;
  GroupKernel *prepare, *move, *move_guarded, *residual, *write_block, *adjoint, *adjoint_outer,
      *adjoint_stiffness, *adjoint_start, *tangent, *tangent_stiffness, *tangent_start,
      *coarse_rows, *coarse_force, *coarse_outer;
};

// Returns the kernels for the instruction set in the environment variable NOVAPHY_CPU_ISA, or for
// the best of this processor. ErrorKind::Runtime: the variable does not name an instruction set of
// this processor.
const SweepLevel& sweep_level();
// Returns the kernels whose groups have `lanes` lanes.
const SweepLevel& sweep_level_of(int64_t lanes);

}  // namespace novaphy::vbd
