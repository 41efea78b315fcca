// The common part of DeviceArray and Tensor: reads, writes and exports of memory as an
// n-dimensional array.
//
// Copies use Array::copy_to_host and copy_from_host. An export shares the memory: it first reports
// a host read, so that a capture can raise an error, and keeps the storage alive. Exports are
// read-only by default. A writable export marks the memory range, so that tapes compare contents.
#pragma once

#include <memory>
#include <vector>

#include "convert.h"
#include "novaphy/core/storage.h"

namespace novaphy::python {

// A memory range as a row-major array of scalars without gaps.
struct View {
  std::shared_ptr<Range> range;  // null only for 0 bytes
  Scalar scalar = Scalar::F32;
  std::vector<int64_t> shape;

  Device device() const { return range ? range->storage().device() : Device::cpu(); }
  int64_t size() const;
  size_t bytes() const { return static_cast<size_t>(size()) * scalar_bytes(scalar); }
  std::vector<int64_t> strides() const;  // bytes
  Array flat() const;                    // the same bytes as an array of scalars
};

py::tuple shape_tuple(const std::vector<int64_t>& shape);
// Returns a shape as text: "(2, 3)".
std::string shape_text(const std::vector<int64_t>& shape);
// Returns the shortest decimal number that rounds to the float32 value: "0.1".
std::string number_text(float number);
// Reads a shape: an int, or a sequence of ints >= 0.
std::vector<int64_t> to_shape(py::handle value);

// Returns a NumPy copy of the values.
py::object copy_to_numpy(const View& view);
// Returns the values for a repr that begins with `prefix`, such as "[1, 2], ". Long arrays are
// abbreviated. In a capture the text is empty, because the values are not computed yet.
std::string values_text(const View& view, const char* prefix);
// Returns a NumPy array over the memory itself. ErrorKind::Runtime: the host cannot access the
// memory.
py::object alias_as_numpy(const View& view, bool writable, const char* what);
py::object view_to_numpy(const View& view, bool copy, bool writable);

// The Python attributes __array__(dtype=None, copy=None), __array_interface__ and
// __cuda_array_interface__.
py::object array_protocol(const View& view, py::handle dtype, py::handle copy);
py::dict array_interface(const View& view);
py::dict cuda_array_interface(const View& view);

// Returns the values of `source` (a number, sequence, NumPy array, or an object with __array__) as
// a contiguous NumPy array of the scalar type. Numbers are rounded to float32. TypeError: floats
// for an integer type, or no numbers. ValueError: integers that do not fit.
py::object host_values(py::handle source, Scalar scalar, const char* what);
// Returns the scalar type that fits the values: float32, int32 or uint8. TypeError: no numbers.
Scalar guess_scalar(py::handle source, const char* what);
// TypeError: `source` is an array of floats with more than 32 bits. Its gradient would be float32.
void require_float32(py::handle source, const char* what);
// Copies host values into a view. The values have the shape of the view, or are flat, or have a
// shape that differs only in dimensions of size 1.
void assign_host_values(const View& view, py::handle source, const char* what);
void check_assignable(const std::vector<int64_t>& target, const std::vector<int64_t>& source,
                      const char* what);

// Returns a copy of the rows at an integer or a slice; assigns such rows, broadcast as in NumPy.
py::object get_rows(const View& view, py::handle index);
void set_rows(const View& view, py::handle index, py::handle values);

// Exports memory by DLPack. Consumers with max_version >= 1.0 get the versioned form, which has a
// read-only flag.
py::object export_dlpack(const View& view, py::handle stream, py::handle max_version,
                         py::handle dl_device, py::handle copy);
py::tuple dlpack_device(const View& view);
// Imports memory of another library by DLPack, and keeps it alive. The memory is shared, and tapes
// treat it as writable by others. BufferError: the memory is read-only. With `copy` it is copied.
View import_dlpack(py::handle source, bool copy);

}  // namespace novaphy::python
