// Docstrings of DeviceArray.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kFromOther[] =
    R"(Wraps an array of another library by DLPack. The memory is shared unless copy=True.

obj: an object with __dlpack__. The DeviceArray keeps the memory alive.
dtype: the type of a row, such as vec3 for an array (n, 3). None: the scalar type of the array.

BufferError: the memory is read-only, or the library does not say whether it is writable (JAX).
With copy=True such an array is accepted.
ValueError: the values have gaps, or the shape does not fit dtype.)";

inline constexpr char kAssign[] =
    R"(Copies values from a DeviceArray, Tensor, NumPy array or list. float64 values are rounded to
float32. An active tape records a copy from a DeviceArray or Tensor.

ValueError: the shape does not fit. Dimensions of size 1 may differ, so (3,) fits (1, 3).)";

inline constexpr char kNumpy[] =
    R"(Returns the values as a NumPy array.

copy: True: a copy. False: an array over the same memory.
writable: with copy=False, whether NumPy may write to the memory. Tapes then compare contents to
detect writes.

novaphy.Error: inside of a capture, or copy=False for an array of a device.)";

}  // namespace novaphy::python::doc
