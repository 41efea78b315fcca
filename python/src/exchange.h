// What DeviceArray and Tensor share: reading, writing and exporting a byte range as an
// n-dimensional array.
//
// Copies go through Array::copy_to_host and copy_from_host. What hands out the memory itself first
// reports a host read, so that a capture can refuse it, and keeps the storage alive. Exports are
// read-only unless asked otherwise; a writable one marks the range.
#pragma once

#include <memory>
#include <vector>

#include "convert.h"
#include "novaphy/core/storage.h"

namespace novaphy::python {

// A range seen as a packed array of scalars.
struct View {
  std::shared_ptr<Range> range;  // null only where there are no bytes
  Scalar scalar = Scalar::F32;
  std::vector<int64_t> shape;

  Device device() const { return range ? range->storage().device() : Device::cpu(); }
  int64_t size() const;
  size_t bytes() const { return static_cast<size_t>(size()) * scalar_bytes(scalar); }
  std::vector<int64_t> strides() const;  // bytes
  Array flat() const;                    // the same bytes as an array of scalars
};

py::tuple shape_tuple(const std::vector<int64_t>& shape);
// (2, 3)
std::string shape_text(const std::vector<int64_t>& shape);
// The fewest digits that give the float32 back: 0.1
std::string number_text(float number);
// An int, or a sequence of ints >= 0.
std::vector<int64_t> to_shape(py::handle value);

// A NumPy copy of the values.
py::object copy_to_numpy(const View& view);
// "[1, 2], " for a repr that begins with the prefix: many values are shortened; "" in a capture, in
// which no value is there yet.
std::string values_text(const View& view, const char* prefix);
// A NumPy array over the memory itself. ErrorKind::Runtime where the host cannot see it.
py::object alias_as_numpy(const View& view, bool writable, const char* what);
py::object view_to_numpy(const View& view, bool copy, bool writable);

// __array__(dtype=None, copy=None), __array_interface__, __cuda_array_interface__
py::object array_protocol(const View& view, py::handle dtype, py::handle copy);
py::dict array_interface(const View& view);
py::dict cuda_array_interface(const View& view);

// Host values of `source` (a number, sequence, NumPy array, or anything with __array__) as a packed
// NumPy array. For float32 numbers of any size are rounded. TypeError: values that the scalar
// cannot hold without a change of kind; ValueError: integers that do not fit.
py::object host_values(py::handle source, Scalar scalar, const char* what);
// The scalar that fits values without a named one: float32, int32 or uint8. TypeError: no numbers.
Scalar guess_scalar(py::handle source, const char* what);
// TypeError for an array of floats of more than 32 bits, whose gradient would have another type.
void require_float32(py::handle source, const char* what);
// Copies host values; their shape must be the view's, or flat, or differ from it only in dimensions
// of 1.
void assign_host_values(const View& view, py::handle source, const char* what);
void check_assignable(const std::vector<int64_t>& target, const std::vector<int64_t>& source,
                      const char* what);

// Rows by an integer or a slice, as a copy; and their assignment, with NumPy's broadcasting.
py::object get_rows(const View& view, py::handle index);
void set_rows(const View& view, py::handle index, py::handle values);

// DLPack, versioned (read-only flag) when the consumer says max_version >= 1.0.
py::object export_dlpack(const View& view, py::handle stream, py::handle max_version,
                         py::handle dl_device, py::handle copy);
py::tuple dlpack_device(const View& view);
// Zero-copy; the producer's memory stays alive. It counts as a writable export. BufferError for
// memory that may not be written, which `copy` copies.
View import_dlpack(py::handle source, bool copy);

}  // namespace novaphy::python
