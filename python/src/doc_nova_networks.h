// Docstrings of the functions for networks.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kUniform[] =
    R"(Returns random numbers in [0, 1), {worlds, width}. No gradient.

A number depends only on its place. Value (w, j) is the upper 24 bits of lane j % 4 of
Philox4x32-10, with the key seed and the counter (j // 4, w, step, stream). The bits are the same on
every device and for any number of threads. The numbers of a world do not depend on the number of
worlds.

step: a number, or an int32 tensor {1} that is read when the launch runs. A captured graph gives new
numbers when the tensor advances.
first_world: the number w of the first row, for a block of the worlds of a larger run.)";

}  // namespace novaphy::python::doc
