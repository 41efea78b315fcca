// Docstrings of the kernels of Nova.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kLaunch[] =
    R"(Runs the kernel over `dim` output rows. Returns a list with one new Tensor per output, {dim,
width} ({dim} for width 1). An active tape records the launch when an input carries a gradient.

extent: the number of items of a fixed sum.
csr: the Incidence of a CSR sum (a kernel with a "csr_row" source).
active: int32 {1} in the device's memory, read when the launch runs. The kernel computes only this
many of the first rows. The other rows stay zero and have no gradient. For kernels without a sum.

ValueError: another shape than the declared one, or an extent or csr that is missing or
that the kernel has no sum for.)";

inline constexpr char kMap[] =
    R"(Makes a kernel out[i] = fn(i) from a Python function, which is traced once. The function
fn(c) reads sources through the TraceContext c, and returns the output columns: Real values, one or
a tuple.

sources: (name, dtype, width, access) each. The access is "direct" (row i), "uniform" (row 0) or
"indexed" (a row from an int32 source).
outputs: a number of columns, or (name, width) each.)";

inline constexpr char kRebuild[] =
    R"(Builds the rows again, into the same arrays, from the present contents of the table.

A capture records the call, so that a replay finds the rows of its own table. A checkpoint runs it
once more. backward() raises RuntimeError where it needs the earlier rows.

IndexError: an entry >= rows; on the CPU the rows are then as before.)";

}  // namespace novaphy::python::doc
