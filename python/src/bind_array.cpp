// DeviceArray and the element types.
#include <cstring>

#include "doc_array.h"
#include "pickle.h"
#ifdef NOVAPHY_PYTHON_DIFF
#include "nova_types.h"
#endif

namespace novaphy::python {
namespace {

View view_of(const Array& array) {
  return {array.range(), dtype_info(array.dtype()).scalar, array.shape()};
}

DType scalar_dtype(Scalar scalar) {
  constexpr DType dtypes[] = {DType::float32, DType::int32, DType::uint32, DType::uint8,
                              DType::uint64};
  return dtypes[static_cast<size_t>(scalar)];
}

// Makes an array from the shape of its NumPy array: (n,) followed by the element's shape, or
// (n, width) for a table of scalars. (n,) alone is accepted for elements of any shape.
Array make_array(DType dtype, const std::vector<int64_t>& shape, Device device) {
  const DTypeInfo& info = dtype_info(dtype);
  require(!shape.empty(), ErrorKind::Value, "shape: expected at least one size");
  const auto rows = static_cast<size_t>(shape[0]);
  if (shape.size() == 1) return Array(dtype, rows, device);
  const std::vector<int64_t> inner(shape.begin() + 1, shape.end());
  if (info.ndim == 0) {
    require(inner.size() == 1 && inner[0] >= 1, ErrorKind::Value,
            "shape: expected (n,) or (n, width) for ", info.name, ", got ", shape_text(shape));
    return Array(dtype, rows, device, static_cast<size_t>(inner[0]));
  }
  const std::vector<int64_t> element(info.shape, info.shape + info.ndim);
  require(inner == element, ErrorKind::Value, "shape: expected (n,) or ",
          shape_text(Array(dtype, rows, device).shape()), " for ", info.name, ", got ",
          shape_text(shape));
  return Array(dtype, rows, device);
}

Array from_view(const View& view, py::handle dtype) {
  require(!view.shape.empty(), ErrorKind::Value, "from_dlpack: expected at least one dimension");
  const DType wanted = dtype.is_none() ? scalar_dtype(view.scalar) : to_dtype(dtype);
  const DTypeInfo& info = dtype_info(wanted);
  require(info.scalar == view.scalar, ErrorKind::Type, "from_dlpack, dtype: expected one of ",
          dtype_info(scalar_dtype(view.scalar)).name, ", got ", info.name);
  size_t width = 1;
  if (info.ndim == 0) {
    require(view.shape.size() <= 2, ErrorKind::Value,
            "from_dlpack: expected shape (n,) or (n, width), got ", shape_text(view.shape));
    if (view.shape.size() == 2) width = static_cast<size_t>(view.shape[1]);
  }
  Array array(wanted, static_cast<size_t>(view.shape[0]), width, view.range);
  return array;
}

Array construct(py::handle data, py::handle dtype, py::handle device) {
  if (py::isinstance<Array>(data) && dtype.is_none()) {
    const auto& source = data.cast<const Array&>();
    return source.to(device.is_none() ? source.device() : to_device(device));
  }
  const DType wanted = dtype.is_none() ? scalar_dtype(guess_scalar(data, "data")) : to_dtype(dtype);
  const DTypeInfo& info = dtype_info(wanted);
  const py::object values = host_values(data, info.scalar, "data");
  auto shape = values.attr("shape").cast<std::vector<int64_t>>();
  if (shape.empty()) shape = {1};
  // A single element of a vector type may lack the dimension of rows.
  const std::vector<int64_t> element(info.shape, info.shape + info.ndim);
  if (info.ndim != 0 && shape == element) shape.insert(shape.begin(), 1);
  require(info.ndim == 0 || std::vector<int64_t>(shape.begin() + 1, shape.end()) == element,
          ErrorKind::Value, "data: expected shape ",
          shape_text(Array(wanted, static_cast<size_t>(shape[0]), Device::cpu()).shape()), " for ",
          info.name, ", got ", shape_text(shape));
  Array array = make_array(wanted, shape, to_device(device));
  if (array.bytes() != 0) {
    const BufferView bytes(values, false);
    array.copy_from_host(bytes.data(), bytes.bytes());
  }
  return array;
}

}  // namespace

void assign_array(Array& array, py::handle source) {
  array.require_writable("assign");
  const View target = view_of(array);
  View from;
  if (py::isinstance<Array>(source)) {
    const auto& other = source.cast<const Array&>();
    from = view_of(other);
    require(target.scalar == from.scalar, ErrorKind::Type, "assign: expected ",
            dtype_info(array.dtype()).name, ", got ", dtype_info(other.dtype()).name);
#ifdef NOVAPHY_PYTHON_DIFF
  } else if (py::isinstance<nova::TensorImpl>(source) &&
             view_of(source.cast<nova::Tensor>()).scalar == target.scalar) {
    from = view_of(source.cast<nova::Tensor>());
#endif
  } else {
    return assign_host_values(target, source, "assign");
  }
  check_assignable(target.shape, from.shape, "assign");
  const ReleasedGil release;
  Array flat = target.flat();
  if (flat.rows() != 0) flat.assign(from.flat());  // a tape records the copy
}

namespace {

void fill(Array& array, py::handle value) {
  const DTypeInfo& info = dtype_info(array.dtype());
  py::object values = host_values(value, info.scalar, "fill_");
  const auto shape = values.attr("shape").cast<std::vector<int64_t>>();
  const std::vector<int64_t> element(info.shape, info.shape + info.ndim);
  const bool single = values.attr("size").cast<int64_t>() == 1;
  require(single || shape == element, ErrorKind::Value,
          "fill_: expected a number or an element of shape ", shape_text(element), ", got shape ",
          shape_text(shape));
  const BufferView bytes(values, false);
  std::vector<unsigned char> pattern(info.bytes);
  for (size_t at = 0; at < pattern.size(); at += bytes.bytes())
    std::memcpy(&pattern[at], bytes.data(), bytes.bytes());
  if (array.bytes() != 0) array.fill_bytes(pattern.data(), pattern.size());
}

std::string repr(const Array& array) {
  return "DeviceArray(" + values_text(view_of(array), "DeviceArray(") +
         "shape=" + shape_text(array.shape()) + ", dtype=" + dtype_info(array.dtype()).name +
         ", device='" + array.device().str() + "')";
}

void bind_dtypes(py::module_& m) {
  py::class_<DTypeObject>(m, "dtype",
                          "The type of an array's elements, such as novaphy.float32 or "
                          "novaphy.vec3.")
      .def_property_readonly(
          "name", [](const DTypeObject& d) { return dtype_info(d.dtype).name; },
          "The name, such as \"vec3\".")
      .def_property_readonly(
          "scalar",
          [](const DTypeObject& d) {
            return dtype_object(scalar_dtype(dtype_info(d.dtype).scalar));
          },
          "The dtype of the element's numbers.")
      .def_property_readonly(
          "shape",
          [](const DTypeObject& d) {
            const DTypeInfo& info = dtype_info(d.dtype);
            return shape_tuple({info.shape, info.shape + info.ndim});
          },
          "The shape of an element: () for a scalar, (3,) for vec3, (3, 3) for mat33.")
      .def_property_readonly(
          "itemsize", [](const DTypeObject& d) { return dtype_info(d.dtype).bytes; },
          "The size of an element (bytes).")
      .def_property_readonly(
          "numpy", [](const DTypeObject& d) { return numpy_dtype(dtype_info(d.dtype).scalar); },
          "The NumPy dtype of the element's numbers.")
      .def("__repr__",
           [](const DTypeObject& d) { return std::string("novaphy.") + dtype_info(d.dtype).name; });
  for (int k = 0; k <= static_cast<int>(DType::vec4i); ++k) {
    const auto dtype = static_cast<DType>(k);
    m.attr(dtype_info(dtype).name) = dtype_object(dtype);
  }
}

}  // namespace

void bind_array(py::module_& m) {
  bind_dtypes(m);
  py::class_<Array> c(
      m, "DeviceArray",
      "An array of rows of one element type, in the memory of a device. Copies of the object share "
      "the memory: a field of a state gives access to the state's own memory. Reads by the host "
      "wait for the device.");
  c.def(py::init([](py::handle data, py::handle dtype, py::handle device) {
          return construct(data, dtype, device);
        }),
        "data"_a, "dtype"_a = py::none(), "device"_a = py::none(),
        "Makes an array from a copy of numbers, lists, a NumPy array or another DeviceArray. "
        "float64 values are rounded to float32. Without a dtype the elements are float32, int32 or "
        "uint8, and data of shape (n, width) makes a table. ValueError: the shape does not fit.")
      .def_static(
          "zeros",
          [](py::handle shape, py::handle dtype, py::handle device) {
            return make_array(to_dtype(dtype), to_shape(shape), to_device(device));
          },
          "shape"_a, "dtype"_a = dtype_object(DType::float32), "device"_a = py::none(),
          "Returns an array of zeros. `shape`: the number of rows, or the NumPy shape.")
      .def_static(
          "empty",
          [](py::handle shape, py::handle dtype, py::handle device) {
            return make_array(to_dtype(dtype), to_shape(shape), to_device(device));
          },
          "shape"_a, "dtype"_a = dtype_object(DType::float32), "device"_a = py::none(),
          "Returns an array of zeros, because memory is always cleared.")
      .def_static(
          "full",
          [](py::handle shape, py::handle value, py::handle dtype, py::handle device) {
            Array array = make_array(to_dtype(dtype), to_shape(shape), to_device(device));
            fill(array, value);
            return array;
          },
          "shape"_a, "value"_a, "dtype"_a = dtype_object(DType::float32), "device"_a = py::none(),
          "Returns an array filled with a number or an element.")
      .def_static(
          "from_dlpack",
          [](py::handle obj, py::handle dtype, bool copy) {
            if (!py::isinstance<Array>(obj)) return from_view(import_dlpack(obj, copy), dtype);
            const auto& own = obj.cast<const Array&>();
            return from_view(view_of(copy ? own.clone() : own), dtype);
          },
          "obj"_a, "dtype"_a = py::none(), "copy"_a = false, doc::kFromOther)
      .def_property_readonly(
          "shape", [](const Array& a) { return shape_tuple(a.shape()); },
          "The shape of the NumPy array: rows, then the components of an element.")
      .def_property_readonly(
          "dtype", [](const Array& a) { return dtype_object(a.dtype()); }, "The dtype of a row.")
      .def_property_readonly(
          "scalar_dtype",
          [](const Array& a) { return dtype_object(scalar_dtype(dtype_info(a.dtype()).scalar)); },
          "The dtype of the elements' numbers.")
      .def_property_readonly(
          "ndim", [](const Array& a) { return a.shape().size(); }, "The number of dimensions.")
      .def_property_readonly(
          "size", [](const Array& a) { return view_of(a).size(); }, "The total count of numbers.")
      .def_property_readonly("nbytes", &Array::bytes, "The size of the memory (bytes).")
      .def_property_readonly(
          "strides", [](const Array& a) { return shape_tuple(view_of(a).strides()); },
          "The distance between entries along each dimension (bytes).")
      .def_property_readonly("device", &Array::device, "The device of the memory.")
      .def_property_readonly(
          "ptr", [](const Array& a) { return reinterpret_cast<uintptr_t>(a.raw()); },
          "The address of the memory on the device.")
      .def_property_readonly(
          "is_contiguous", [](const Array&) { return true; }, "True: rows are tightly packed.")
      .def_property_readonly("version", &Array::version,
                             "A number that grows with every write to the array by the engine.")
      .def("__len__", &Array::rows)
      .def("__repr__", &repr)
      .def(
          "numpy",
          [](const Array& a, bool copy, bool writable) {
            if (!copy && writable) a.require_writable("numpy");
            return view_to_numpy(view_of(a), copy, writable);
          },
          "copy"_a = true, "writable"_a = false, doc::kNumpy)
      .def("assign", &assign_array, "source"_a, doc::kAssign)
      .def("copy_from", &assign_array, "other"_a, "Copies values, as assign.")
      .def(
          "fill_",
          [](const py::object& self, py::handle value) {
            fill(self.cast<Array&>(), value);
            return self;
          },
          "value"_a, "Sets every row to a number or to one element. Returns the array.")
      .def(
          "zero_",
          [](const py::object& self) {
            self.cast<Array&>().zero();
            return self;
          },
          "Sets all values to zero. Returns the array.")
      .def(
          "clone",
          [](const Array& a, py::handle device) {
            return a.to(device.is_none() ? a.device() : to_device(device));
          },
          "device"_a = py::none(), "Returns a copy on a device.")
      .def(
          "to", [](const Array& a, py::handle device) { return a.to(to_device(device)); },
          "device"_a, "Returns a copy on a device.")
      .def(
          "__getitem__",
          [](const Array& a, py::handle index) { return get_rows(view_of(a), index); }, "index"_a)
      .def("__iter__", [](const Array& a) { return py::iter(copy_to_numpy(view_of(a))); })
      .def(
          "__setitem__",
          [](Array& a, py::handle index, py::handle values) {
            a.require_writable("[]");
            set_rows(view_of(a), index, values);
          },
          "index"_a, "values"_a)
      .def(
          "__array__",
          [](const Array& a, py::handle dtype, py::handle copy) {
            return array_protocol(view_of(a), dtype, copy);
          },
          "dtype"_a = py::none(), "copy"_a = py::none())
      .def(
          "__dlpack__",
          [](const Array& a, py::handle stream, py::handle max_version, py::handle dl_device,
             py::handle copy) {
            a.require_writable("__dlpack__");
            return export_dlpack(view_of(a), stream, max_version, dl_device, copy);
          },
          py::kw_only(), "stream"_a = py::none(), "max_version"_a = py::none(),
          "dl_device"_a = py::none(), "copy"_a = py::none())
      .def("__dlpack_device__", [](const Array& a) { return dlpack_device(view_of(a)); })
      .def_property_readonly(
          "__array_interface__",
          [](const Array& a) {
            if (!a.device().is_cpu())
              throw py::attribute_error("__array_interface__: the array is not on the cpu");
            return array_interface(view_of(a));
          })
      .def_property_readonly("__cuda_array_interface__", [](const Array& a) {
        if (a.device().type != DeviceType::CUDA)
          throw py::attribute_error("__cuda_array_interface__: the array is not on a CUDA device");
        a.require_writable("__cuda_array_interface__");
        return cuda_array_interface(view_of(a));
      });
  add_array_pickle(c);
#ifdef NOVAPHY_PYTHON_DIFF
  bind_array_gradient(c);
#endif
}

}  // namespace novaphy::python
