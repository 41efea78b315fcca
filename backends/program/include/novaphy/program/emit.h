// Program -> C: the text that a compiler turns into native code, and that users read.
//
// The text is one function over a range of rows. The function names lane types and functions (vf, vi, vm,
// load3f, vselect_f, ...). A prelude gives their meaning for one width of lanes: the host compiler
// has backends/cpu/src/lanes.h. The same text serves every width, one lane included. Each width
// gives the same bits as an interpreter of the Program:
//  - Every operation of the Program is one operation of the text, in the order of schedule().
//    Nothing is contracted or reassociated.
//  - Values that are the same in every lane are plain C scalars, computed before the rows as far as
//    possible.
//  - A region that no lane of a group needs is jumped over.
#pragma once

#include <string>
#include <vector>

#include "novaphy/program/ir.h"
#include "novaphy/program/scan.h"

namespace nova::ir {

// Returns the C text of a Program. `function`: the name of the C function; empty: a name from the
// Program's name and hash.
std::string emit_c(const Program& program, const std::string& function = {});
// Returns the function that runs many launches, with the name `function`. The function of a
// `primal` notes, for groups of rows, the launches in which no contact touches and no limit is
// reached. The function of its adjoint has a short form for such launches.
std::string emit_c_scan(const Program& program, const Scan& scan, const std::string& function,
                        const Program* primal = nullptr);
// Returns whether `adjoint` belongs to `primal` and may use its notes. Both Programs must compute
// the conditions of a launch without contacts and limits in the same way.
bool adjoint_of_scan(const Program& adjoint, const Program& primal);
// Returns the text for a GPU: a C++ function of one row. Its template parameters are the kinds of
// access to each source and output (s0, o0, ...), which backends/gpu/src/device_prelude.cuh
// defines. `items` marks sources. The caller loads the first items of each CSR sum from a marked
// source, and passes them in the parameter `kept` (see backends/gpu/src/kept_items.h).
std::string emit_device(const Program& program, const std::string& function,
                        const std::vector<char>& items = {});
// Returns a legal C name such as "step_particles_0123456789abcdef". Equal Programs with equal names
// get the same name.
std::string c_function_name(const Program& program);

}  // namespace nova::ir
