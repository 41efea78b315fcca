// Docstrings of the kernels of Nova.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kLaunch[] =
    R"(Runs the kernel for `dim` output rows. Returns a list with a new Tensor for each output:
{dim, width}, or {dim} for width 1. An active tape records the launch if an input requires a
gradient.

dim: the number of output rows.
inputs: the tensors of the declared sources, in order.
params: the launch parameters (float or int), in order.
extent: the number of terms of a sum over "reduced" sources.
csr: the Incidence of a sum over "csr_row" sources.
active: an int32 tensor {1} on the device, which is read when the launch runs: the kernel computes
only the first active[0] rows. The other rows are zero and have no gradient. Only for kernels
without a sum.

ValueError: an input has another shape than declared. ValueError: extent or csr is missing, or is
given to a kernel without such a sum.)";

inline constexpr char kMap[] =
    R"(Makes a kernel that computes row i of its outputs by a Python function. The function is
traced once, when the kernel is made.

name: the name of the kernel.
sources: a list of tuples (name, dtype, width, access). The access says which row of the source the
function reads: "direct" (row i), "uniform" (row 0) or "indexed" (a row from an int32 source).
outputs: the number of columns of a single output, or a list of tuples (name, width).
fn: fn(c) reads the sources through the TraceContext c, and returns the columns of all outputs: one
Real or a tuple of Reals.)";

inline constexpr char kRebuild[] =
    R"(Updates offsets and items, in place, to the present contents of the index table.

A capture records the call, so each replay uses the contents that the table then has. A checkpoint
repeats the call. backward() raises RuntimeError if it needs earlier contents.

IndexError: an entry is >= rows. On the CPU the Incidence is then unchanged.)";

inline constexpr char kReduce[] =
    R"(Makes a kernel out[i] = epilogue(i, init(i) + sum over r of body(i, r)). Terms are added in
ascending order of r.

sources, outputs: as in make_indexed_kernel. A source may also have the access "reduced" (row r, for
r from 0 to extent - 1) or "csr_row" (the slots of row i in an Incidence).
body: body(c) returns the term of the sum: one Real or a tuple of Reals.
init: init(c) returns the initial value of the sum; None: 0.
epilogue: epilogue(c, sums) returns the columns of the outputs; None: the sums.)";

inline constexpr char kIncidence[] =
    R"(The inverse of an index table: for each row, the slots (entries of the table) that refer to
the row, in ascending order.)";

}  // namespace novaphy::python::doc
