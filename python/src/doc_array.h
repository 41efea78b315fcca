// Docstrings of DeviceArray.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kFromOther[] =
    R"(Wraps the memory of an array of another library, without a copy unless copy=True.

BufferError: the memory may not be written, or its producer does not say that it may (JAX).
copy=True takes such memory too.
ValueError: memory that is not tightly packed.)";

inline constexpr char kAssign[] =
    R"(Copies values from a DeviceArray, Tensor, NumPy array or list. float64 values are rounded. A
tape records the copy of an array or tensor.

ValueError: another number of values; (3,) fits (1, 3).)";

}  // namespace novaphy::python::doc
