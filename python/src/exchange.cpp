#include "exchange.h"

#include <charconv>
#include <cstring>

#ifdef NOVAPHY_PYTHON_DIFF
#include "nova_types.h"
#endif

namespace novaphy::python {
namespace {

// Exposes memory through Python's buffer protocol and keeps the storage alive. A NumPy array over
// the engine's memory has such an object as its base.
struct HostBuffer {
  std::shared_ptr<Range> range;
  std::vector<int64_t> shape;
  Scalar scalar;
  bool writable;
};

const char* type_string(Scalar scalar) {
  switch (scalar) {
    case Scalar::F32:
      return "<f4";
    case Scalar::I32:
      return "<i4";
    case Scalar::U32:
      return "<u4";
    case Scalar::U8:
      return "|u1";
    case Scalar::U64:
      break;
  }
  return "<u8";
}

void report_host_read(const char* what) {
  if (ArrayObserver* observer = array_observer()) observer->host_read(what);
}

// Prepares memory for direct access by the host. ErrorKind::Runtime: it is memory of a device.
void open_to_host(const View& view, const char* what) {
  report_host_read(what);
  if (view.range == nullptr) return;
  require(view.device().is_cpu(), ErrorKind::Runtime, what, ": the host cannot see memory of ",
          view.device().str(), "; ask for a copy");
  synchronize(view.device());
}

std::vector<int64_t> without_ones(const std::vector<int64_t>& shape) {
  std::vector<int64_t> result;
  for (const int64_t n : shape)
    if (n != 1) result.push_back(n);
  return result;
}

// Returns whether NumPy treats the object as an array. NumPy's scalars count as numbers.
bool is_array_like(py::handle source) {
  return PyObject_HasAttrString(source.ptr(), "__array__") != 0 &&
         !py::isinstance(source, numpy().generic);
}

int64_t product(const std::vector<int64_t>& shape) {
  int64_t n = 1;
  for (const int64_t d : shape) n *= d;
  return n;
}

std::vector<int64_t> shape_of(py::handle array) {
  return array.attr("shape").cast<std::vector<int64_t>>();
}

bool is_row_index(py::handle index) {
  return PySlice_Check(index.ptr()) ||
         (PyIndex_Check(index.ptr()) && !PySequence_Check(index.ptr()));
}

// Checks a row index, so that errors speak of rows. NumPy's messages would speak of "axis 0".
py::object checked_index(const View& view, py::handle index) {
  require(is_row_index(index), ErrorKind::Type,
          "index: expected an integer or a slice of rows, got ", type_name(index));
  require(!view.shape.empty(), ErrorKind::Index, "index: the array has no rows");
  if (PySlice_Check(index.ptr())) return py::reinterpret_borrow<py::object>(index);
  const py::ssize_t row = PyNumber_AsSsize_t(index.ptr(), PyExc_IndexError);
  if (row == -1 && PyErr_Occurred()) throw py::error_already_set();
  const int64_t rows = view.shape[0];
  require(row >= -rows && row < rows, ErrorKind::Index, "index: expected a row of ", rows, ", got ",
          row);
  return py::int_(row < 0 ? row + rows : row);
}

}  // namespace

int64_t View::size() const { return product(shape); }

std::vector<int64_t> View::strides() const {
  std::vector<int64_t> result(shape.size());
  auto stride = static_cast<int64_t>(scalar_bytes(scalar));
  for (size_t k = shape.size(); k-- > 0;) {
    result[k] = stride;
    stride *= shape[k];
  }
  return result;
}

Array View::flat() const {
  constexpr DType dtypes[] = {DType::float32, DType::int32, DType::uint32, DType::uint8,
                              DType::uint64};
  const DType dtype = dtypes[static_cast<size_t>(scalar)];
  if (range == nullptr) return Array(dtype, 0, Device::cpu());
  return Array(dtype, static_cast<size_t>(size()), 1, range);
}

py::tuple shape_tuple(const std::vector<int64_t>& shape) {
  py::tuple result(shape.size());
  for (size_t k = 0; k < shape.size(); ++k) result[k] = shape[k];
  return result;
}

std::string shape_text(const std::vector<int64_t>& shape) { return py::str(shape_tuple(shape)); }

std::string number_text(float number) {
  char digits[32];
  return {digits, std::to_chars(digits, digits + sizeof(digits), number).ptr};
}

std::vector<int64_t> to_shape(py::handle value) {
  std::vector<int64_t> shape;
  if (PyIndex_Check(value.ptr()) && !PySequence_Check(value.ptr())) {
    shape.push_back(value.cast<int64_t>());
  } else {
    try {
      shape = value.cast<std::vector<int64_t>>();
    } catch (const py::cast_error&) {
      fail(ErrorKind::Type, "shape: expected an integer or a sequence of integers, got ",
           type_name(value));
    }
  }
  for (const int64_t n : shape)
    require(n >= 0, ErrorKind::Value, "shape: expected sizes >= 0, got ", n);
  return shape;
}

py::object copy_to_numpy(const View& view) {
  py::object array = numpy().empty(shape_tuple(view.shape), numpy_dtype(view.scalar));
  if (view.bytes() == 0) {
    report_host_read("numpy");
    return array;
  }
  const BufferView target(array, true);
  view.flat().copy_to_host(target.data(), target.bytes());
  return array;
}

std::string values_text(const View& view, const char* prefix) {
#ifdef NOVAPHY_PYTHON_DIFF
  if (nova::current_capture() != nullptr) return "";
#endif
  return std::string(py::str(py::module_::import("numpy").attr("array2string")(
             copy_to_numpy(view), "separator"_a = ", ", "threshold"_a = 60, "prefix"_a = prefix))) +
         ", ";
}

py::object alias_as_numpy(const View& view, bool writable, const char* what) {
  open_to_host(view, what);
  if (view.bytes() == 0) return numpy().empty(shape_tuple(view.shape), numpy_dtype(view.scalar));
  if (writable) {
    if (ArrayObserver* observer = array_observer()) observer->untracked_write(*view.range, what);
    view.range->mark_writable_export();
  }
  return numpy().asarray(py::cast(new HostBuffer{view.range, view.shape, view.scalar, writable},
                                  py::return_value_policy::take_ownership));
}

py::object view_to_numpy(const View& view, bool copy, bool writable) {
  if (copy) return copy_to_numpy(view);
  return alias_as_numpy(view, writable, "numpy(copy=False)");
}

py::object array_protocol(const View& view, py::handle dtype, py::handle copy) {
  const bool alias = !copy.is_none() && !py::cast<bool>(copy);
  const bool same = dtype.is_none() || numpy().dtype(dtype).equal(numpy_dtype(view.scalar));
  if (alias) {
    require(same, ErrorKind::Value, "__array__: a change of dtype needs a copy");
    return alias_as_numpy(view, false, "__array__(copy=False)");
  }
  py::object array = copy_to_numpy(view);
  return same ? array : array.attr("astype")(dtype);
}

py::dict array_interface(const View& view) {
  open_to_host(view, "__array_interface__");
  const auto address = reinterpret_cast<uintptr_t>(view.range ? view.range->data() : nullptr);
  return py::dict("version"_a = 3, "shape"_a = shape_tuple(view.shape),
                  "typestr"_a = type_string(view.scalar), "data"_a = py::make_tuple(address, true),
                  "strides"_a = py::none());
}

py::dict cuda_array_interface(const View& view) {
  report_host_read("__cuda_array_interface__");
  synchronize(view.device());
  const auto address = reinterpret_cast<uintptr_t>(view.range->data());
  // Consumers ignore the read-only flag of the protocol, or reject read-only memory. The memory is
  // therefore exported as writable.
  view.range->mark_writable_export();
  return py::dict("version"_a = 3, "shape"_a = shape_tuple(view.shape),
                  "typestr"_a = type_string(view.scalar), "data"_a = py::make_tuple(address, false),
                  "strides"_a = py::none(), "stream"_a = 1);  // 1: the device's default stream
}

namespace {

// Raises an error if the source requires a gradient, because no tape records this copy.
void refuse_gradient([[maybe_unused]] py::handle source, [[maybe_unused]] const char* what) {
#ifdef NOVAPHY_PYTHON_DIFF
  const nova::Tape* const tape = nova::Tape::active();
  if (tape == nullptr) return;
  std::shared_ptr<Range> range;
  if (py::isinstance<nova::TensorImpl>(source)) range = source.cast<nova::Tensor>().range();
  if (py::isinstance<Array>(source)) range = source.cast<const Array&>().range();
  require(range == nullptr || !tape->carries_gradient(*range), ErrorKind::Runtime, what,
          ": expected values without a gradient, which would silently stop here: assign or copy_ "
          "all of an array, which the tape records, or take detach()");
#endif
}

}  // namespace

py::object host_values(py::handle source, Scalar scalar, const char* what) {
  const NumPy& np = numpy();
  refuse_gradient(source, what);
  const bool is_array = is_array_like(source);
  py::object array;
  try {
    array = np.asarray(source);
  } catch (py::error_already_set& error) {
    if (!error.matches(PyExc_ValueError) && !error.matches(PyExc_TypeError)) throw;
    fail(error.matches(PyExc_TypeError) ? ErrorKind::Type : ErrorKind::Value, what,
         ": expected numbers in rows of equal length (", error.what(), ")");
  }
  const py::object wanted = numpy_dtype(scalar), given = array.attr("dtype");
  if (given.equal(wanted)) return np.asarray(array, "order"_a = "C");
  const std::string kind = py::str(given.attr("kind")), given_name = py::str(given);
  const bool integers = kind == "i" || kind == "u" || kind == "b";
  // NumPy gives an empty list the type float64.
  if (array.attr("size").cast<int64_t>() == 0 && !is_array)
    return np.empty(array.attr("shape"), wanted);
  bool ok = scalar == Scalar::F32 && (kind == "f" || integers);  // values are rounded
  if (scalar != Scalar::F32 && integers) {
    const py::object limits = np.iinfo(wanted);
    if (array.attr("size").cast<int64_t>() != 0) {
      const py::object low = array.attr("min")(), high = array.attr("max")();
      const bool fits = py::int_(low) >= limits.attr("min") && py::int_(high) <= limits.attr("max");
      require(fits, ErrorKind::Value, what, ": expected values of ", std::string(py::str(wanted)),
              ", got ", std::string(py::str(low)), " to ", std::string(py::str(high)));
    }
    ok = true;
  }
  require(ok, ErrorKind::Type, what, ": expected ", std::string(py::str(wanted)), ", got ",
          is_array ? "an array of " : "", given_name, is_array ? "; convert it with astype" : "");
  return np.asarray(array, wanted, "order"_a = "C");
}

Scalar guess_scalar(py::handle source, const char* what) {
  const NumPy& np = numpy();
  const bool is_array = is_array_like(source);
  const py::object dtype = np.asarray(source).attr("dtype");
  const std::string kind = py::str(dtype.attr("kind"));
  if (is_array)
    for (size_t k = 0; k < 5; ++k)
      if (dtype.equal(np.scalars[k])) return static_cast<Scalar>(k);
  if (kind == "b") return Scalar::U8;
  if (kind == "i" || kind == "u") return Scalar::I32;
  if (kind == "f") return Scalar::F32;
  fail(ErrorKind::Type, what, ": expected numbers, got ", is_array ? "an array of " : "",
       std::string(py::str(dtype)));
}

void require_float32(py::handle source, const char* what) {
  if (!is_array_like(source)) return;
  const py::object dtype = numpy().asarray(source).attr("dtype");
  const bool wide = dtype.attr("itemsize").cast<size_t>() > 4;
  require(!wide || std::string(py::str(dtype.attr("kind"))) != "f", ErrorKind::Type, what,
          ": expected float32 with requires_grad=True, as its gradient is, got an array of ",
          std::string(py::str(dtype)), "; convert it with astype(numpy.float32)");
}

void check_assignable(const std::vector<int64_t>& target, const std::vector<int64_t>& source,
                      const char* what) {
  const bool same_count = product(target) == product(source);
  const bool ok =
      same_count && (source.size() <= 1 || without_ones(source) == without_ones(target));
  require(ok, ErrorKind::Value, what, ": expected shape ", shape_text(target), ", got ",
          shape_text(source));
}

void assign_host_values(const View& view, py::handle source, const char* what) {
  const py::object array = host_values(source, view.scalar, what);
  check_assignable(view.shape, shape_of(array), what);
  if (view.bytes() == 0) return;
  const BufferView values(array, false);
  view.flat().copy_from_host(values.data(), values.bytes());
}

py::object get_rows(const View& view, py::handle index) {
  const py::object key = checked_index(view, index);
  if (!view.device().is_cpu()) return copy_to_numpy(view)[key];
  const py::object rows = alias_as_numpy(view, false, "indexing")[key];
  return rows.attr("copy")();
}

void set_rows(const View& view, py::handle index, py::handle values) {
  const py::object key = checked_index(view, index);
  const py::object array = host_values(values, view.scalar, "assignment");
  if (view.bytes() == 0) return;
  if (!view.device().is_cpu()) {
    py::object whole = copy_to_numpy(view);
    whole[key] = array;
    assign_host_values(view, whole, "assignment");
    return;
  }
  open_to_host(view, "assignment");
  view.flat().raw_mutable();  // raises in a capture; increments the version
  py::object memory =
      numpy().asarray(py::cast(new HostBuffer{view.range, view.shape, view.scalar, true},
                               py::return_value_policy::take_ownership));
  memory[key] = array;
}

void bind_host_buffer(py::module_& m) {
  py::class_<HostBuffer>(m, "_HostBuffer", py::buffer_protocol(), "Memory of an array, for NumPy.")
      .def_buffer([](HostBuffer& b) {
        const char* formats[] = {"f", "i", "I", "B", "Q"};
        const View view{b.range, b.scalar, b.shape};
        std::vector<py::ssize_t> shape(b.shape.begin(), b.shape.end());
        const std::vector<int64_t> strides = view.strides();
        return py::buffer_info(
            b.range->data(), static_cast<py::ssize_t>(scalar_bytes(b.scalar)),
            formats[static_cast<size_t>(b.scalar)], static_cast<py::ssize_t>(shape.size()), shape,
            std::vector<py::ssize_t>(strides.begin(), strides.end()), !b.writable);
      });
}

}  // namespace novaphy::python
