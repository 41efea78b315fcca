// Docstrings of Tensor.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kGetItem[] =
    R"(Returns a copy of entries by NumPy's indices: integers, slices and "...". The first index may be
an int32 tensor, a list, or an array of integers or truth values. The tensor names rows then.

An active tape records the copy. A single value is {1}. IndexError: no such entry.)";

inline constexpr char kFromDlpack[] =
    R"(Wraps the memory of an array of another library, without a copy unless copy=True.
BufferError: the memory may not be written, or its producer does not say that it may (JAX).
copy=True takes such memory too.)";

inline constexpr char kWhere[] =
    R"(Returns a where the condition (int32 or float32) is not 0, else b. Tensors and numbers are
broadcast as in NumPy. No gradient flows to the condition.)";

inline constexpr char kGather[] =
    R"(Returns the rows of x that an int32 tensor of any shape names: index.shape + x.shape[1:]. The
gradient of a row that is named several times is the sum in the order of the index. IndexError: an
entry outside of 0 to len(x) - 1.)";

}  // namespace novaphy::python::doc
