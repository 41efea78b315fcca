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

// `function`: the name of the C function; empty: one made of the Program's name and hash.
std::string emit_c(const Program& program, const std::string& function = {});
// The function that runs many launches, whose name is `function`. That of a `primal` notes for
// groups of rows the launches in which no contact touches and no limit is met; that of its adjoint
// has a short form for these.
std::string emit_c_scan(const Program& program, const Scan& scan, const std::string& function,
                        const Program* primal = nullptr);
// Whether `adjoint` is one of `primal` and may take the notes of that for its own: what makes its
// launches more than quiet ones is computed alike there.
bool adjoint_of_scan(const Program& adjoint, const Program& primal);
// The same for a GPU: a C++ function of one row, templated on how each source and output is reached
// (s0, o0, ...), whose names backends/gpu/src/device_prelude.cuh gives a meaning.
// With `items`, the sources that it names are kept for the first items of each CSR loop in what the
// function takes as `kept` (see backends/gpu/src/kept_items.h).
std::string emit_device(const Program& program, const std::string& function,
                        const std::vector<char>& items = {});
// "step_particles_0123456789abcdef": a legal C name, the same for equal Programs of one name.
std::string c_function_name(const Program& program);

}  // namespace nova::ir
