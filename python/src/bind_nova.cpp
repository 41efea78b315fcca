// Bindings of the creation of tensors, and of functions of tensors.
#include <cmath>
#include <limits>

#include "doc_nova_tensor.h"
#include "nova_types.h"
#include "novaphy/nova/ops.h"

namespace novaphy::python {

using nova::Tensor;

nova::DType to_nova_dtype(py::handle value) {
  const DType dtype = to_dtype(value);
  switch (dtype) {
    case DType::float32:
      return nova::DType::F32;
    case DType::int32:
      return nova::DType::I32;
    case DType::uint8:
      return nova::DType::U8;
    default:
      fail(ErrorKind::Type, "dtype: expected float32, int32 or uint8, got ",
           dtype_info(dtype).name);
  }
}

DType dtype_of(nova::DType dtype) {
  return dtype == nova::DType::F32   ? DType::float32
         : dtype == nova::DType::I32 ? DType::int32
                                     : DType::uint8;
}

View view_of(const Tensor& tensor) {
  const Scalar scalar = tensor.dtype() == nova::DType::F32   ? Scalar::F32
                        : tensor.dtype() == nova::DType::I32 ? Scalar::I32
                                                             : Scalar::U8;
  return {tensor.range(), scalar, tensor.shape()};
}

Tensor tensor_of(const View& view) {
  const bool known =
      view.scalar == Scalar::F32 || view.scalar == Scalar::I32 || view.scalar == Scalar::U8;
  require(known, ErrorKind::Type, "tensor: expected float32, int32 or uint8");
  const nova::DType dtype = view.scalar == Scalar::F32   ? nova::DType::F32
                            : view.scalar == Scalar::I32 ? nova::DType::I32
                                                         : nova::DType::U8;
  return {view.range, view.shape, dtype};
}

namespace {

Tensor with_grad(const Tensor& tensor, bool requires_grad) {
  if (requires_grad) tensor.set_requires_grad(true);
  return tensor;
}

Tensor make_tensor(py::handle data, py::handle dtype, py::handle device, bool requires_grad) {
  if (requires_grad) require_float32(data, "data");
  Scalar scalar = Scalar::F32;
  if (dtype.is_none()) {
    scalar = guess_scalar(data, "data");
  } else {
    scalar = dtype_info(dtype_of(to_nova_dtype(dtype))).scalar;
  }
  const py::object values = host_values(data, scalar, "data");
  auto shape = values.attr("shape").cast<nova::Shape>();
  if (shape.empty()) shape = {1};
  const View plain{nullptr, scalar, shape};
  const nova::DType type = scalar == Scalar::F32   ? nova::DType::F32
                           : scalar == Scalar::I32 ? nova::DType::I32
                                                   : nova::DType::U8;
  require(scalar != Scalar::U32 && scalar != Scalar::U64, ErrorKind::Type,
          "data: expected float32, int32 or uint8, got an unsigned integer array; convert it with "
          "astype");
  require(!requires_grad || type == nova::DType::F32, ErrorKind::Value,
          "requires_grad: only float32 tensors have gradients");
  const Tensor tensor(shape, type, to_device(device));
  if (plain.bytes() != 0) {
    const UntrackedScope fresh;
    const BufferView bytes(values, false);
    tensor.copy_from_host(bytes.data(), bytes.bytes());
  }
  return with_grad(tensor, requires_grad);
}

// Returns the value as a T. ErrorKind::Value: T cannot hold the value exactly.
template <class T>
T whole_number(double value) {
  constexpr double low = std::numeric_limits<T>::min(), high = std::numeric_limits<T>::max();
  require(value >= low && value <= high && value == std::trunc(value), ErrorKind::Value,
          "value: expected a whole number from ", low, " to ", high, ", got ", value);
  return static_cast<T>(value);
}

Tensor filled(py::handle shape, double value, py::handle dtype, py::handle device,
              bool requires_grad) {
  const Tensor tensor(to_shape(shape), to_nova_dtype(dtype), to_device(device));
  if (value != 0.0 && tensor.size() != 0) {
    const UntrackedScope fresh;
    Array flat = view_of(tensor).flat();
    const auto fill = [&flat](auto number) { flat.fill_bytes(&number, sizeof(number)); };
    switch (tensor.dtype()) {
      case nova::DType::F32:
        fill(static_cast<float>(value));
        break;
      case nova::DType::I32:
        fill(whole_number<int32_t>(value));
        break;
      case nova::DType::U8:
        fill(whole_number<uint8_t>(value));
        break;
    }
  }
  return with_grad(tensor, requires_grad);
}

Tensor arange(int64_t start, std::optional<int64_t> stop, int64_t step, py::handle dtype,
              py::handle device) {
  const py::object values = py::module_::import("numpy")
                                .attr("arange")(stop ? start : 0, stop ? *stop : start, step)
                                .attr("tolist")();
  return make_tensor(values, dtype, device, false);
}

void bind_creation(py::module_& m) {
  const py::object f32 = dtype_object(DType::float32);
  m.def("tensor", &make_tensor, "data"_a, "dtype"_a = py::none(), "device"_a = py::none(),
        "requires_grad"_a = false, doc::kMakeTensor)
      .def(
          "from_numpy",
          [](py::handle a, py::handle device, bool requires_grad) {
            return make_tensor(a, py::none(), device, requires_grad);
          },
          "a"_a, "device"_a = py::none(), "requires_grad"_a = false,
          "Makes a tensor from a copy of a NumPy array. To share the memory, use from_dlpack.")
      .def(
          "from_dlpack",
          [](py::handle obj, bool copy) {
            Tensor own;
            if (py::isinstance<nova::TensorImpl>(obj)) own = obj.cast<Tensor>();
            if (py::isinstance<Array>(obj)) own = Tensor::view(obj.cast<const Array&>());
            if (own.defined()) return copy ? own.detach() : own;
            return tensor_of(import_dlpack(obj, copy));
          },
          "obj"_a, "copy"_a = false, doc::kFromDlpack)
      .def(
          "from_device_array",
          [](const Array& a, bool requires_grad) { return Tensor::view(a, requires_grad); },
          "array"_a, "requires_grad"_a = false, doc::kFromDeviceArray)
      .def(
          "external",
          [](uintptr_t ptr, py::handle shape, py::handle dtype, py::handle device,
             const py::object& owner) {
            auto keep = std::make_shared<Callback>(owner);
            const Tensor t = Tensor::external(reinterpret_cast<void*>(ptr), to_shape(shape),
                                              to_nova_dtype(dtype), to_device(device), keep);
            if (t.size() != 0) t.range()->mark_writable_export();
            return t;
          },
          "ptr"_a, "shape"_a, "dtype"_a, "device"_a, "owner"_a, doc::kExternal)
      .def(
          "zeros",
          [](py::handle shape, py::handle dtype, py::handle device, bool grad) {
            return filled(shape, 0.0, dtype, device, grad);
          },
          "shape"_a, "dtype"_a = f32, "device"_a = py::none(), "requires_grad"_a = false,
          "Returns a tensor of zeros.")
      .def(
          "empty",
          [](py::handle shape, py::handle dtype, py::handle device, bool grad) {
            return filled(shape, 0.0, dtype, device, grad);
          },
          "shape"_a, "dtype"_a = f32, "device"_a = py::none(), "requires_grad"_a = false,
          "Returns a tensor of zeros, because memory is always cleared.")
      .def(
          "ones",
          [](py::handle shape, py::handle dtype, py::handle device, bool grad) {
            return filled(shape, 1.0, dtype, device, grad);
          },
          "shape"_a, "dtype"_a = f32, "device"_a = py::none(), "requires_grad"_a = false,
          "Returns a tensor of ones.")
      .def("full", &filled, "shape"_a, "value"_a, "dtype"_a = f32, "device"_a = py::none(),
           "requires_grad"_a = false,
           "Returns a tensor filled with one value, rounded to float32. ValueError: dtype is an "
           "integer type that cannot hold the value.")
      .def(
          "zeros_like", [](const Tensor& t) { return Tensor(t.shape(), t.dtype(), t.device()); },
          "tensor"_a, "Returns zeros with the shape, dtype and device of a tensor.")
      .def("arange", &arange, "start"_a, "stop"_a = py::none(), "step"_a = 1,
           "dtype"_a = dtype_object(DType::int32), "device"_a = py::none(),
           "Returns the integers from start to before stop, with a step, as in NumPy. arange(n) "
           "gives 0 to n - 1.");
}

#define NOVAPHY_BINARY(name, doc)                                                             \
  m.def(                                                                                      \
      #name, [](const Tensor& a, const Tensor& b) { return nova::name(a, b); }, "a"_a, "b"_a, \
      release_gil(), doc);
#define NOVAPHY_UNARY(name, doc) \
  m.def(                         \
      #name, [](const Tensor& x) { return nova::name(x); }, "x"_a, release_gil(), doc);

// Reads a number. TypeError: a Tensor, because its gradient would be lost.
float to_number(py::handle value, const char* name) {
  require(!py::isinstance<nova::TensorImpl>(value), ErrorKind::Type, name,
          ": expected a number, got a Tensor");
  return to_float(value, name);
}

void bind_functions(py::module_& m) {
  NOVAPHY_BINARY(add, "Returns a + b, broadcast as in NumPy.")
  NOVAPHY_BINARY(sub, "Returns a - b, broadcast as in NumPy.")
  NOVAPHY_BINARY(mul, "Returns a * b, broadcast as in NumPy.")
  NOVAPHY_BINARY(div, "Returns a / b, broadcast as in NumPy.")
  NOVAPHY_BINARY(minimum, doc::kMinimum)
  NOVAPHY_BINARY(maximum, doc::kMaximum)
  m.def(
      "min", [](const Tensor& a, const Tensor& b) { return nova::minimum(a, b); }, "a"_a, "b"_a,
      release_gil());
  m.def(
      "max", [](const Tensor& a, const Tensor& b) { return nova::maximum(a, b); }, "a"_a, "b"_a,
      release_gil());
  m.def(
      "add", [](const Tensor& a, float b) { return nova::add(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "sub", [](const Tensor& a, float b) { return nova::sub(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "sub", [](float a, const Tensor& b) { return nova::sub(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "mul", [](const Tensor& a, float b) { return nova::mul(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "div", [](const Tensor& a, float b) { return nova::div(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "div", [](float a, const Tensor& b) { return nova::div(a, b); }, "a"_a, "b"_a, release_gil());
  NOVAPHY_UNARY(neg, "Returns -x.")
  NOVAPHY_UNARY(abs, "Returns |x|. The derivative is -1 below 0, else +1.")
  NOVAPHY_UNARY(sqrt, "Returns the square root. The gradient at 0 is 0.")
  NOVAPHY_UNARY(exp, "Returns e^x.")
  NOVAPHY_UNARY(log, "Returns the natural logarithm.")
  NOVAPHY_UNARY(sin, "Returns the sine of x (rad).")
  NOVAPHY_UNARY(cos, "Returns the cosine of x (rad).")
  NOVAPHY_UNARY(tanh, "Returns the hyperbolic tangent.")
  NOVAPHY_UNARY(acos, doc::kAcos)
  m.def(
      "atan2", [](const Tensor& y, const Tensor& x) { return nova::atan2(y, x); }, "y"_a, "x"_a,
      release_gil(), doc::kAtan2);
  m.def(
      "clamp",
      [](const Tensor& x, py::handle lower, py::handle upper) {
        const float limits[] = {to_number(lower, "lower"), to_number(upper, "upper")};
        const ReleasedGil release;
        return nova::clamp(x, limits[0], limits[1]);
      },
      "x"_a, "lower"_a, "upper"_a,
      "Returns x clamped to [lower, upper]. The gradient is 1 inside and at the bounds, else 0.");
  NOVAPHY_BINARY(pow, doc::kPow)
  m.def(
      "pow", [](const Tensor& a, float b) { return nova::pow(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "pow", [](float a, const Tensor& b) { return nova::pow(a, b); }, "a"_a, "b"_a, release_gil());
  m.def(
      "where",
      [](const Tensor& condition, py::handle a, py::handle b) {
        const Tensor x = to_operand(a, "a", condition.device());
        const Tensor y = to_operand(b, "b", condition.device());
        const ReleasedGil release;
        return nova::where(condition, x, y);
      },
      "condition"_a, "a"_a, "b"_a, doc::kWhere);
  NOVAPHY_UNARY(norm, "Returns the Euclidean norm of all values {1}. The gradient at 0 is 0.")
  NOVAPHY_UNARY(sum_rows, "Returns the sum {1, w} of the rows of a tensor {n, w}.")
  m.def(
      "dot", [](const Tensor& a, const Tensor& b) { return nova::dot(a, b); }, "a"_a, "b"_a,
      release_gil(), "Returns the sum {1} of all values of a * b.");
}

void bind_shapes(py::module_& m) {
  m.def("sum", &reduced<Reduction::Sum>, "x"_a, "axis"_a = py::none(), "keepdims"_a = false,
        release_gil(), doc::kSum)
      .def("mean", &reduced<Reduction::Mean>, "x"_a, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(),
           "Returns the mean {1} of all values, or the means along the dimension `axis`.")
      .def("max", &reduced<Reduction::Max>, "x"_a, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), doc::kMax)
      .def("min", &reduced<Reduction::Min>, "x"_a, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), doc::kMin)
      .def(
          "broadcast_to",
          [](const Tensor& x, py::handle shape) { return nova::broadcast_to(x, to_shape(shape)); },
          "x"_a, "shape"_a, "Returns x repeated to a shape, as in NumPy.")
      .def(
          "gather", [](const Tensor& x, const Tensor& index) { return nova::gather(x, index); },
          "x"_a, "index"_a, release_gil(), doc::kGather)
      .def(
          "concat",
          [](const std::vector<Tensor>& parts, int64_t axis) { return nova::concat(parts, axis); },
          "parts"_a, "axis"_a = 0, release_gil(),
          "Returns tensors joined along the dimension `axis`. All other dimensions must be equal.")
      .def(
          "stack",
          [](const std::vector<Tensor>& parts, int64_t axis) { return nova::stack(parts, axis); },
          "parts"_a, "axis"_a = 0, release_gil(),
          "Returns tensors of equal shape stacked along a new dimension, which has the number "
          "`axis` in the result.")
      .def(
          "transpose",
          [](const Tensor& x, const std::optional<std::vector<int64_t>>& axes) {
            return nova::transpose(x, axes ? *axes : std::vector<int64_t>());
          },
          "x"_a, "axes"_a = py::none(), release_gil(),
          "Returns a copy of x whose dimension k is the dimension axes[k] of x. None: the order of "
          "dimensions is reversed.");
  NOVAPHY_BINARY(matmul,
                 "Returns the matrix product of {n, k} or {k} and {k, m} or {k}. Each value is "
                 "summed in ascending k.")
  NOVAPHY_BINARY(cross, "Returns a x b of vectors {..., 3}, broadcast in the other dimensions.")
  NOVAPHY_BINARY(quat_mul,
                 "Returns the Hamilton product a b of quaternions {..., 4}, (x, y, z, w). The "
                 "product is the rotation b followed by the rotation a.")
  m.def(
       "quat_rotate", [](const Tensor& q, const Tensor& v) { return nova::quat_rotate(q, v); },
       "q"_a, "v"_a, release_gil(),
       "Returns the vectors v {..., 3} rotated by unit quaternions q {..., 4}, (x, y, z, w). For "
       "the inverse rotation pass q * nova.tensor([-1, -1, -1, 1]).")
      .def(
          "quat_exp", [](const Tensor& r) { return nova::quat_exp(r); }, "r"_a, release_gil(),
          "Returns the unit quaternions {..., 4} of rotation vectors {..., 3} (rad).")
      .def(
          "quat_log", [](const Tensor& q) { return nova::quat_log(q); }, "q"_a, release_gil(),
          "Returns the rotation vectors {..., 3} (rad) of quaternions {..., 4}. A rotation vector "
          "has a length of at most pi, and q and -q give the same vector. The gradient jumps at "
          "the angle pi.");
}

}  // namespace

template <Reduction R>
Tensor reduced(const Tensor& x, std::optional<int64_t> axis, bool keepdims) {
  constexpr const char* kNames[] = {"sum", "mean", "max", "min"};
  require(axis || !keepdims, ErrorKind::Value, kNames[static_cast<size_t>(R)],
          ", keepdims: expected an axis with it");
  if constexpr (R == Reduction::Sum) return axis ? nova::sum(x, *axis, keepdims) : nova::sum(x);
  if constexpr (R == Reduction::Mean) return axis ? nova::mean(x, *axis, keepdims) : nova::mean(x);
  if constexpr (R == Reduction::Max) return axis ? nova::max(x, *axis, keepdims) : nova::max(x);
  if constexpr (R == Reduction::Min) return axis ? nova::min(x, *axis, keepdims) : nova::min(x);
}
template Tensor reduced<Reduction::Sum>(const Tensor&, std::optional<int64_t>, bool);
template Tensor reduced<Reduction::Mean>(const Tensor&, std::optional<int64_t>, bool);
template Tensor reduced<Reduction::Max>(const Tensor&, std::optional<int64_t>, bool);
template Tensor reduced<Reduction::Min>(const Tensor&, std::optional<int64_t>, bool);

Tensor to_operand(py::handle value, const char* name, const Device& device) {
  if (py::isinstance<nova::TensorImpl>(value)) return value.cast<Tensor>();
  return Tensor::full({1}, to_float(value, name), device);
}

void bind_nova(py::module_& m) {
  for (const DType dtype : {DType::float32, DType::int32, DType::uint8})
    m.attr(dtype_info(dtype).name) = dtype_object(dtype);
  bind_creation(m);
  bind_functions(m);
  bind_shapes(m);
}

}  // namespace novaphy::python
