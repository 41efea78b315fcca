// Docstrings of Tensor.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kGetItem[] =
    R"(Returns a copy of entries by NumPy's indices: integers, slices and "...". The first index may be
an int32 tensor, a list, or an array of integers or truth values. The tensor names rows then.

An active tape records the copy. A single value is {1}. IndexError: no such entry.)";

}  // namespace novaphy::python::doc
