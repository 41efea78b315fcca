// Docstrings of the functions for networks.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kUniform[] =
    R"(Returns uniform random numbers in [0, 1), {worlds, width}. No gradient.

The generator has no state: a number depends only on seed, step, stream, its row w and its column j.
The number (w, j) is the upper 24 bits of word j % 4 of Philox4x32-10 with the key `seed` and the
counter (j // 4, w, step, stream). The bits are the same on every device, for any number of threads,
and for any number of worlds.

shape: (worlds, width).
seed: 0 to 2^64 - 1.
step: an integer, or an int32 tensor {1} that is read when the launch runs. A replay of a captured
graph gives new numbers if the tensor has changed.
stream: an integer that separates independent uses of one seed.
first_world: the number w of the first row, for a block of worlds of a larger run.)";

}  // namespace novaphy::python::doc
