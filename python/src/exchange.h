// The common part of DeviceArray and Tensor: reads, writes and exports of a byte range as an
// n-dimensional array.
//
// Copies use Array::copy_to_host and copy_from_host. A function that exports the memory itself
// first reports a host read, so that a capture can refuse it, and keeps the storage alive. Exports
// are read-only unless requested otherwise. A writable export marks the range.
#pragma once

#include <memory>
#include <vector>

#include "convert.h"
#include "novaphy/core/storage.h"

namespace novaphy::python {

// A range seen as a packed array of scalars.
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
// Returns "[1, 2], " for a repr that begins with the prefix. Many values are shortened. In a
// capture the text is empty, because the values are not computed yet.
std::string values_text(const View& view, const char* prefix);
// Returns a NumPy array over the memory itself. ErrorKind::Runtime: the host cannot access the
// memory.
py::object alias_as_numpy(const View& view, bool writable, const char* what);
py::object view_to_numpy(const View& view, bool copy, bool writable);

// __array__(dtype=None, copy=None), __array_interface__, __cuda_array_interface__
py::object array_protocol(const View& view, py::handle dtype, py::handle copy);
py::dict array_interface(const View& view);
py::dict cuda_array_interface(const View& view);

// Returns the host values of `source` (a number, sequence, NumPy array, or an object with
// __array__) as a packed NumPy array. Numbers of any size are rounded to float32. TypeError: the
// scalar type cannot hold the values without a change of kind. ValueError: integers that do not
// fit.
py::object host_values(py::handle source, Scalar scalar, const char* what);
// Returns the scalar type for values without a dtype: float32, int32 or uint8. TypeError: no
// numbers.
Scalar guess_scalar(py::handle source, const char* what);
// TypeError: an array of floats with more than 32 bits, whose gradient would have another type.
void require_float32(py::handle source, const char* what);
// Copies host values. Their shape is that of the view, or flat, or differs from it only in
// dimensions of size 1.
void assign_host_values(const View& view, py::handle source, const char* what);
void check_assignable(const std::vector<int64_t>& target, const std::vector<int64_t>& source,
                      const char* what);

// Returns a copy of rows by an integer or a slice, or assigns such rows with NumPy's broadcasting.
py::object get_rows(const View& view, py::handle index);
void set_rows(const View& view, py::handle index, py::handle values);

// Exports by DLPack. The versioned form, with a read-only flag, is for consumers with max_version
// >= 1.0.
py::object export_dlpack(const View& view, py::handle stream, py::handle max_version,
                         py::handle dl_device, py::handle copy);
py::tuple dlpack_device(const View& view);
// Imports by DLPack without a copy, and keeps the producer's memory alive. The import counts as a
// writable export. BufferError: the memory may not be written. With `copy` such memory is copied.
View import_dlpack(py::handle source, bool copy);

}  // namespace novaphy::python
