// Translates a Program to C source, which a compiler turns into native code and users can read.
//
// The source is one function over a range of rows. A lane is one row of a SIMD vector. The source
// uses names of lane types and functions (vf, vi, vm, load3f, vselect_f, ...), which a header
// defines for one number of lanes. The header for the host compiler is backends/cpu/src/lanes.h.
// The same source works for every number of lanes, including one, and always gives the bits of an
// interpreter of the Program:
// - Every operation of the Program is one operation of the source, in the order of schedule().
//   Nothing is contracted or reassociated.
// - Values that are the same in every lane are plain C scalars, computed before the rows as far as
//   possible.
// - Code that no lane of a group needs is skipped.
#pragma once

#include <string>
#include <vector>

#include "novaphy/program/ir.h"
#include "novaphy/program/scan.h"

namespace nova::ir {

// Returns the C text of a Program. `function` is the name of the C function. If empty, the name is
// made of the Program's name and hash.
std::string emit_c(const Program& program, const std::string& function = {});
// Returns the C function that runs many launches as one scan, with the name `function`. With
// `primal` null, the function records, for groups of rows, the launches without a touching contact
// and without a reached limit. With `primal`, the Program is its adjoint, and the function has a
// short form for such launches.
std::string emit_c_scan(const Program& program, const Scan& scan, const std::string& function,
                        const Program* primal = nullptr);
// Returns whether `adjoint` is the adjoint of `primal` and may use its records. Both Programs must
// compute the conditions of a launch without contacts and limits in the same way.
bool adjoint_of_scan(const Program& adjoint, const Program& primal);
// Returns the text for a GPU: a C++ function of one row. Its template parameters are the kinds of
// access to each source and output (s0, o0, ...), which backends/gpu/src/device_prelude.cuh
// defines. `items` marks sources, one flag each. The caller loads the first items of each CSR sum
// from a marked source and passes them in the parameter `kept` (see backends/gpu/src/kept_items.h).
std::string emit_device(const Program& program, const std::string& function,
                        const std::vector<char>& items = {});
// Returns a legal C name such as "step_particles_0123456789abcdef". Equal Programs with equal names
// get the same name.
std::string c_function_name(const Program& program);

}  // namespace nova::ir
