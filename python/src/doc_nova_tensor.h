// Docstrings of Tensor.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kGetItem[] =
    R"(Returns a copy of entries by NumPy's indices: integers, slices and "...". The first index may
be an int32 tensor, a list, or an array of integers or truth values. Such an index selects rows.

An active tape records the copy. A single value has the shape {1}. IndexError: an index is out of
range.)";

inline constexpr char kFromDlpack[] =
    R"(Returns a tensor over the memory of an array of another library, by DLPack. copy=True copies.

obj: an object with __dlpack__. The tensor keeps the memory alive.

BufferError: the memory is read-only, or the library does not say whether it is writable (JAX).
With copy=True such an array is accepted.)";

inline constexpr char kWhere[] =
    R"(Returns a where the condition (int32 or float32) is not 0, else b. Tensors and numbers are
broadcast as in NumPy. No gradient flows to the condition.)";

inline constexpr char kGather[] =
    R"(Returns the rows x[index] for an int32 tensor `index` of any shape. The result has the shape
index.shape + x.shape[1:]. If a row is selected several times, its gradient is the sum in the order
of the index. IndexError: an entry is outside of 0 to len(x) - 1.)";

inline constexpr char kMakeTensor[] =
    R"(Makes a tensor from a copy of numbers, lists or arrays. float64 values are rounded to
float32.

dtype: float32, int32 or uint8; None: the type that fits the data.
device: None: the default device.
requires_grad: whether the tensor is a leaf.

TypeError: a float64 array with requires_grad=True.)";

inline constexpr char kFromDeviceArray[] =
    R"(Returns a tensor over the memory of a DeviceArray, without a copy. A vec3 array of n rows
gives {n, 3}. Repeated calls for an array return the same tensor.)";

inline constexpr char kExternal[] =
    R"(Returns a tensor over the memory at the address `ptr` on a device, without a copy. The tensor
keeps `owner` alive, the object that owns the memory.)";

inline constexpr char kAcos[] =
    R"(Returns the arc cosine (rad) of x, clamped to [-1, 1]. The gradient is 0 for x <= -1 and x >=
1.)";

inline constexpr char kAtan2[] =
    R"(Returns the angle (rad) of the point (x, y), broadcast as in NumPy. The gradient at the
origin is 0.)";

inline constexpr char kMinimum[] =
    R"(Returns the smaller of a and b, broadcast as in NumPy. The gradient goes to a if a < b, else
to b.)";

inline constexpr char kMaximum[] =
    R"(Returns the larger of a and b, broadcast as in NumPy. The gradient goes to a if a > b, else
to b.)";

inline constexpr char kPow[] =
    R"(Returns a to the power of b, broadcast as in NumPy. pow(a, 2) has the bits of a * a.)";

inline constexpr char kSum[] =
    R"(Returns the sum {1} of all values, or the sums along the dimension `axis`. The order of
additions is fixed.)";

inline constexpr char kMax[] =
    R"(Returns the largest of all values {1}, or the largest values along the dimension `axis`. If
several values are equal, one of them gets the gradient. For the larger of two tensors use
maximum.)";

inline constexpr char kMin[] =
    R"(Returns the smallest of all values {1}, or the smallest values along the dimension `axis`. If
several values are equal, one of them gets the gradient. For the smaller of two tensors use
minimum.)";

inline constexpr char kTensorNumpy[] =
    R"(Returns the values as a NumPy array.

copy: True: a copy. False: an array over the same memory.
writable: with copy=False, whether NumPy may write to the memory.

novaphy.Error: inside of a capture, or copy=False for a tensor of a device.)";

inline constexpr char kTensorAssign[] =
    R"(Copies values from a Tensor, NumPy array or list into this tensor. A tape does not record the
call. float64 values are rounded to float32. ValueError: the number of values differs.)";

inline constexpr char kCopy[] =
    R"(Copies the values of another tensor into this tensor, and returns this tensor. An active tape
records the copy.)";

}  // namespace novaphy::python::doc
