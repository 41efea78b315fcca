#include "convert.h"

#include <cctype>

namespace novaphy::python {
namespace {

// Access to the items of a tuple, list, array or other sequence, but not of a string. The
// references to the items are borrowed.
class Items {
 public:
  Items(py::handle value, const char* name, const char* expected) {
    if (!PyUnicode_Check(value.ptr()) && !PyBytes_Check(value.ptr())) {
      items_ = py::reinterpret_steal<py::object>(PySequence_Fast(value.ptr(), ""));
      if (!items_) PyErr_Clear();
    }
    require(static_cast<bool>(items_), ErrorKind::Type, name, ": expected ", expected, ", got ",
            type_name(value));
  }
  size_t size() const { return static_cast<size_t>(PySequence_Fast_GET_SIZE(items_.ptr())); }
  py::handle operator[](size_t k) const {
    return PySequence_Fast_GET_ITEM(items_.ptr(), static_cast<py::ssize_t>(k));
  }

 private:
  py::object items_;
};

bool is_ndarray(py::handle value) {
  // The attribute is tested first, so that NumPy is not imported for other types.
  return PyObject_HasAttrString(value.ptr(), "__array_interface__") != 0;
}

// Returns an array as a C-contiguous NumPy array of the scalar type, with shape (n, columns), or
// (n,) for columns = 0.
py::object packed(py::handle value, const char* name, Scalar scalar, size_t columns) {
  const NumPy& np = numpy();
  const py::object array = np.asarray(value);
  const std::string kind = py::str(array.attr("dtype").attr("kind"));
  const bool ok = kind == "i" || kind == "u" || (kind == "f" && scalar == Scalar::F32);
  require(ok, ErrorKind::Type, name, ": expected an array of ",
          scalar == Scalar::F32 ? "numbers" : "integers", ", got ",
          std::string(py::str(array.attr("dtype"))));
  const auto shape = array.attr("shape").cast<std::vector<int64_t>>();
  const bool fits = columns == 0 ? shape.size() == 1
                                 : shape.size() == 2 && shape[1] == static_cast<int64_t>(columns);
  require(fits, ErrorKind::Value, name, ": expected shape (n",
          columns ? ", " + std::to_string(columns) : std::string(","), "), got ",
          std::string(py::str(array.attr("shape"))));
  return np.asarray(array, numpy_dtype(scalar), "order"_a = "C");
}

template <class T>
std::vector<T> list_from_array(py::handle value, const char* name, Scalar scalar, size_t columns) {
  const BufferView view(packed(value, name, scalar, columns), false);
  const auto* first = static_cast<const T*>(view.data());
  return std::vector<T>(first, first + view.bytes() / sizeof(T));
}

std::string indexed(const char* name, size_t k) {
  return std::string(name) + "[" + std::to_string(k) + "]";
}

}  // namespace

std::string type_name(py::handle value) {
  const py::handle type(reinterpret_cast<PyObject*>(Py_TYPE(value.ptr())));
  const std::string module = py::str(type.attr("__module__"));
  const std::string name = py::str(type.attr("__qualname__"));
  return module == "builtins" ? name : module + "." + name;
}

float to_float(py::handle value, const char* name) {
  if (PyFloat_CheckExact(value.ptr())) return static_cast<float>(PyFloat_AS_DOUBLE(value.ptr()));
  const double number = PyFloat_AsDouble(value.ptr());
  if (number == -1.0 && PyErr_Occurred()) {
    PyErr_Clear();
    fail(ErrorKind::Type, name, ": expected a number, got ", type_name(value));
  }
  return static_cast<float>(number);
}

int32_t to_int32(py::handle value, const char* name) {
  const auto index = py::reinterpret_steal<py::object>(PyNumber_Index(value.ptr()));
  if (!index) {
    PyErr_Clear();
    fail(ErrorKind::Type, name, ": expected an integer, got ", type_name(value));
  }
  int overflow = 0;
  const long long number = PyLong_AsLongLongAndOverflow(index.ptr(), &overflow);
  require(overflow == 0 && number >= INT32_MIN && number <= INT32_MAX, ErrorKind::Value, name,
          ": expected an int32, got ", std::string(py::str(index)));
  return static_cast<int32_t>(number);
}

void to_floats(py::handle value, const char* name, std::span<float> out) {
  const Items items(value, name, "a sequence of numbers");
  require(items.size() == out.size(), ErrorKind::Value, name, ": expected ", out.size(),
          " numbers, got ", items.size());
  for (size_t k = 0; k < out.size(); ++k) out[k] = to_float(items[k], name);
}

Vec3f to_vec3(py::handle value, const char* name) {
  float v[3];
  to_floats(value, name, v);
  return {v[0], v[1], v[2]};
}
Vec4f to_vec4(py::handle value, const char* name) {
  float v[4];
  to_floats(value, name, v);
  return {v[0], v[1], v[2], v[3]};
}

Transformf to_transform(py::handle value, const char* name) {
  if (value.is_none()) return Transformf::identity();
  const Items items(value, name, "a transform of 7 numbers or a pair (position, quaternion)");
  float v[7];
  if (items.size() == 2) {
    to_floats(items[0], name, std::span<float>(v, 3));
    to_floats(items[1], name, std::span<float>(v + 3, 4));
  } else {
    require(items.size() == 7, ErrorKind::Value, name,
            ": expected 7 numbers (px, py, pz, qx, qy, qz, qw), got ", items.size());
    to_floats(value, name, v);
  }
  return {{v[0], v[1], v[2]}, {v[3], v[4], v[5], v[6]}};
}

ShapeConfig shape_config(const ModelBuilder& builder, const ShapeConfig* cfg, py::handle color) {
  ShapeConfig config = cfg != nullptr ? *cfg : builder.default_shape_cfg;
  if (!color.is_none()) config.color = to_vec3(color, "color");
  return config;
}

std::vector<Vec3f> to_vec3_list(py::handle value, const char* name) {
  if (is_ndarray(value)) return list_from_array<Vec3f>(value, name, Scalar::F32, 3);
  const Items items(value, name, "a sequence of positions");
  std::vector<Vec3f> result;
  result.reserve(items.size());
  for (size_t k = 0; k < items.size(); ++k)
    result.push_back(to_vec3(items[k], indexed(name, k).c_str()));
  return result;
}
std::vector<float> to_float_list(py::handle value, const char* name) {
  if (is_ndarray(value)) return list_from_array<float>(value, name, Scalar::F32, 0);
  const Items items(value, name, "a sequence of numbers");
  std::vector<float> result;
  result.reserve(items.size());
  for (size_t k = 0; k < items.size(); ++k) result.push_back(to_float(items[k], name));
  return result;
}
std::vector<int32_t> to_int_list(py::handle value, const char* name) {
  const Items items(value, name, "a sequence of integers");
  std::vector<int32_t> result;
  result.reserve(items.size());
  for (size_t k = 0; k < items.size(); ++k) result.push_back(to_int32(items[k], name));
  return result;
}

Device to_device(py::handle value) {
  if (value.is_none()) return default_device();
  if (py::isinstance<Device>(value)) return value.cast<Device>();
  require(PyUnicode_Check(value.ptr()) != 0, ErrorKind::Type,
          "device: expected a name or a Device, got ", type_name(value));
  return Device::parse(value.cast<std::string>());
}

Axis to_axis(py::handle value) {
  if (PyUnicode_Check(value.ptr())) {
    const std::string text = value.cast<std::string>();
    const char letter = text.size() == 1
                            ? static_cast<char>(std::tolower(static_cast<unsigned char>(text[0])))
                            : '?';
    require(letter >= 'x' && letter <= 'z', ErrorKind::Value,
            "axis: expected \"x\", \"y\" or \"z\", got \"", text, "\"");
    return static_cast<Axis>(letter - 'x');
  }
  if (PyIndex_Check(value.ptr()) && !PySequence_Check(value.ptr())) {
    const int32_t number = to_int32(value, "axis");
    require(number >= 0 && number <= 2, ErrorKind::Value,
            "axis: expected 0 (X), 1 (Y) or 2 (Z), got ", number);
    return static_cast<Axis>(number);
  }
  const Vec3f v = to_vec3(value, "axis");
  for (const Axis axis : {Axis::X, Axis::Y, Axis::Z})
    if (v == axis_vector(axis)) return axis;
  fail(ErrorKind::Value, "axis: expected a unit vector along x, y or z, got (", v.x, ", ", v.y,
       ", ", v.z, ")");
}

GravitySpec to_gravity(py::handle value) {
  if (value.is_none()) return {};
  if (PySequence_Check(value.ptr())) return to_vec3(value, "gravity");
  return to_float(value, "gravity");
}

py::tuple to_tuple(const Vec3f& value) { return py::make_tuple(value.x, value.y, value.z); }

namespace {

constexpr size_t kDTypeCount = static_cast<size_t>(DType::vec4i) + 1;
DTypeObject dtype_objects[kDTypeCount];

}  // namespace

py::object dtype_object(DType dtype) {
  DTypeObject& object = dtype_objects[static_cast<size_t>(dtype)];
  object.dtype = dtype;
  return py::cast(&object, py::return_value_policy::reference);
}

DType to_dtype(py::handle value) {
  if (py::isinstance<DTypeObject>(value)) return value.cast<const DTypeObject&>().dtype;
  std::string name;
  if (PyUnicode_Check(value.ptr())) {
    name = value.cast<std::string>();
  } else {
    try {
      name = py::str(numpy().dtype(value).attr("name"));
    } catch (py::error_already_set&) {
      fail(ErrorKind::Type, "dtype: expected a novaphy dtype, got ", type_name(value));
    }
  }
  if (name == "bool") return DType::uint8;
  for (size_t k = 0; k < kDTypeCount; ++k)
    if (name == dtype_info(static_cast<DType>(k)).name) return static_cast<DType>(k);
  fail(PyUnicode_Check(value.ptr()) ? ErrorKind::Value : ErrorKind::Type, "dtype: there is no ",
       name, "; expected float32, int32, uint32, uint8, uint64, vec2, vec3, ...");
}

const NumPy& numpy() {
  // The import may release the GIL for a time, so another thread may create the object meanwhile.
  // The object is never destroyed, because Python ends before static objects are destroyed.
  static const NumPy* np = nullptr;
  if (np == nullptr) {
    const py::module_ module = py::module_::import("numpy");
    auto* made = new NumPy;
    made->asarray = module.attr("asarray");
    made->empty = module.attr("empty");
    made->generic = module.attr("generic");
    made->dtype = module.attr("dtype");
    made->iinfo = module.attr("iinfo");
    const char* names[] = {"float32", "int32", "uint32", "uint8", "uint64"};
    for (size_t k = 0; k < 5; ++k) made->scalars[k] = made->dtype(names[k]);
    np = made;
  }
  return *np;
}

const py::object& numpy_dtype(Scalar scalar) {
  return numpy().scalars[static_cast<size_t>(scalar)];
}

}  // namespace novaphy::python
