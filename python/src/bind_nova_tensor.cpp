// Bindings of nova.Tensor.
#include "doc_nova_tensor.h"
#include "nova_types.h"
#include "novaphy/nova/ops.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

void assign_tensor(const Tensor& self, py::handle source) {
  if (py::isinstance<nova::TensorImpl>(source)) {
    const auto other = source.cast<Tensor>();
    check_assignable(self.shape(), other.shape(), "assign");
    const ReleasedGil release;
    self.copy_(other);
    return;
  }
  assign_host_values(view_of(self), source, "assign");
}

// Returns the same memory in another shape. One size may be -1, which means the remaining size.
Tensor reshape(const Tensor& self, const py::args& args) {
  py::object sizes = args.size() == 1 && PySequence_Check(py::object(args[0]).ptr())
                         ? py::object(args[0])
                         : py::object(args);
  nova::Shape shape;
  try {
    shape = sizes.cast<nova::Shape>();
  } catch (const py::cast_error&) {
    fail(ErrorKind::Type, "reshape: expected integers, got ", type_name(sizes));
  }
  int64_t known = 1, free_at = -1;
  for (size_t k = 0; k < shape.size(); ++k) {
    if (shape[k] == -1 && free_at < 0) {
      free_at = static_cast<int64_t>(k);
    } else if (__builtin_mul_overflow(known, shape[k], &known)) {
      known = 0;
    }
  }
  if (free_at >= 0 && known > 0 && self.size() % known == 0)
    shape[static_cast<size_t>(free_at)] = self.size() / known;
  return self.reshape(shape);
}

py::object grad_of(const Tensor& self) {
  if (self.dtype() != nova::DType::F32 || !(self.requires_grad() || self.has_grad()))
    return py::none();
  return py::cast(self.grad());
}

std::string repr(const Tensor& t) {
  return "Tensor(" + values_text(view_of(t), "Tensor(") + "shape=" + shape_text(t.shape()) +
         ", dtype=" + nova::dtype_name(t.dtype()) + ", device='" + t.device().str() + "'" +
         (t.requires_grad() ? ", requires_grad=True" : "") + ")";
}

// Returns the value of a tensor with one value, as a Python number.
py::object item(const Tensor& t) {
  require(t.size() == 1, ErrorKind::Value, "item: expected one value, got shape ",
          nova::shape_str(t.shape()));
  return copy_to_numpy(view_of(t)).attr("item")();
}

bool truth(const Tensor& t) {
  require(t.size() == 1, ErrorKind::Value, "bool: a tensor of shape ", nova::shape_str(t.shape()),
          " has no single truth value; compare its numpy()");
  return py::bool_(item(t));
}

// Pickles the values. After unpickling they have separate memory. ErrorKind::Runtime: the tensor is
// a recorded result, whose copy would seem to have the gradient.
py::tuple keep(const Tensor& t) {
  require(t.is_leaf(), ErrorKind::Runtime,
          "pickle, copy: the tensor is the result of a recorded operation; take t.detach()");
  return py::make_tuple(view_of(t).flat(), shape_tuple(t.shape()), nova::dtype_name(t.dtype()),
                        t.requires_grad());
}
std::shared_ptr<nova::TensorImpl> unkept(const py::tuple& kept) {
  const auto values = kept[0].cast<Array>();
  const auto shape = kept[1].cast<nova::Shape>();
  const nova::DType dtype = to_nova_dtype(kept[2]);
  const Tensor t = values.rows() == 0 ? Tensor(shape, dtype, values.device())
                                      : Tensor(values.range(), shape, dtype);
  if (kept[3].cast<bool>()) t.set_requires_grad(true);
  return t.impl();
}

using TensorClass = py::class_<nova::TensorImpl, std::shared_ptr<nova::TensorImpl>>;

void bind_properties(TensorClass& c) {
  c.def_property_readonly(
       "shape", [](const Tensor& t) { return shape_tuple(t.shape()); },
       "The sizes of the dimensions.")
      .def_property_readonly("ndim", method<&Tensor::ndim>, "The number of dimensions.")
      .def_property_readonly("size", method<&Tensor::size>, "The total count of values.")
      .def_property_readonly(
          "dtype", [](const Tensor& t) { return dtype_object(dtype_of(t.dtype())); },
          "The dtype: float32, int32 or uint8.")
      .def_property_readonly("device", method<&Tensor::device>, "The device of the memory.")
      .def_property_readonly(
          "strides", [](const Tensor& t) { return shape_tuple(view_of(t).strides()); },
          "The distance between entries along each dimension (bytes).")
      .def_property_readonly(
          "itemsize", [](const Tensor& t) { return nova::dtype_bytes(t.dtype()); },
          "The size of a value (bytes).")
      .def_property_readonly("nbytes", method<&Tensor::bytes>, "The size of all values (bytes).")
      .def_property_readonly(
          "data_ptr",
          [](const Tensor& t) { return reinterpret_cast<uintptr_t>(t.range()->data()); },
          "The address of the memory on the device.")
      .def_property_readonly(
          "is_contiguous", [](const Tensor&) { return true; },
          "True: the values are tightly packed.")
      .def_property_readonly("is_external", method<&Tensor::is_external>,
                             "Whether the memory belongs to another object.")
      .def_property_readonly("is_leaf", method<&Tensor::is_leaf>,
                             "Whether the tensor is not the result of an operation on an existing "
                             "tape.")
      .def_property_readonly("version", method<&Tensor::version>,
                             "A number that grows with every write to the memory.")
      .def_property("requires_grad", method<&Tensor::requires_grad>,
                    method<&Tensor::set_requires_grad>,
                    "Whether tapes record operations on the tensor and compute its gradient. "
                    "ValueError: the tensor is not float32.")
      .def_property_readonly(
          "grad", &grad_of,
          "The gradient of a loss by this tensor, a Tensor of the same shape. None: the tensor "
          "requires no gradient. Before the first backward pass the gradient is zero.");
}

void bind_methods(TensorClass& c) {
  c.def(
       "numpy",
       [](const Tensor& t, bool copy, bool writable) {
         return view_to_numpy(view_of(t), copy, writable);
       },
       "copy"_a = true, "writable"_a = false, doc::kTensorNumpy)
      .def("item", &item, "Returns the value of a tensor with one value, as a Python number.")
      .def(
          "tolist",
          [](const Tensor& t) { return py::object(copy_to_numpy(view_of(t)).attr("tolist")()); },
          "Returns the values as nested lists.")
      .def("clone", method<&Tensor::clone>, release_gil(),
           "Returns a copy, recorded on an active tape.")
      .def("detach", method<&Tensor::detach>, release_gil(), "Returns a copy that no tape records.")
      .def(
          "to", [](const Tensor& t, py::handle device) { return t.to(to_device(device)); },
          "device"_a, "Returns a copy on a device.")
      .def("reshape", &reshape, "Returns the same memory in another shape. One size may be -1.")
      .def(
          "copy_",
          [](const py::object& self, const Tensor& source) {
            const auto t = self.cast<Tensor>();
            {
              const ReleasedGil release;
              t.copy_(source);
            }
            return self;
          },
          "source"_a, doc::kCopy)
      .def("assign", &assign_tensor, "source"_a, doc::kTensorAssign)
      .def(
          "fill_",
          [](const py::object& self, float value) {
            self.cast<Tensor>().fill_(value);
            return self;
          },
          "value"_a, "Sets all values (float32); returns self.")
      .def(
          "zero_",
          [](const py::object& self) {
            const auto t = self.cast<Tensor>();
            if (t.dtype() == nova::DType::F32) {
              t.fill_(0.0f);
            } else {
              view_of(t).flat().zero();
            }
            return self;
          },
          "Sets all values to zero; returns self.")
      .def("zero_grad", method<&Tensor::zero_grad>, "Sets the gradient to zero.")
      .def("sum", &reduced<Reduction::Sum>, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), "Returns nova.sum of the tensor.")
      .def("mean", &reduced<Reduction::Mean>, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), "Returns nova.mean of the tensor.")
      .def("max", &reduced<Reduction::Max>, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), "Returns nova.max of the tensor.")
      .def("min", &reduced<Reduction::Min>, "axis"_a = py::none(), "keepdims"_a = false,
           release_gil(), "Returns nova.min of the tensor.")
      .def_property_readonly(
          "T", [](const Tensor& t) { return nova::transpose(t); },
          "A copy with the dimensions in reverse order, by nova.transpose.")
      .def("__len__",
           [](const Tensor& t) {
             require(t.ndim() != 0, ErrorKind::Type, "len: the tensor has no dimension");
             return t.dim(0);
           })
      .def("__getitem__", &get_item, "index"_a, doc::kGetItem)
      .def("__iter__",
           [](const py::object& self) {
             return py::reinterpret_steal<py::object>(PySeqIter_New(self.ptr()));
           })
      .def("__float__", [](const Tensor& t) { return py::float_(item(t)); })
      .def("__int__", [](const Tensor& t) { return py::int_(item(t)); })
      .def("__bool__", &truth)
      .def("__format__",
           [](const Tensor& t, const py::str& spec) -> py::str {
             if (py::len(spec) == 0) return repr(t);
             return item(t).attr("__format__")(spec);
           })
      .def(
          "__array__",
          [](const Tensor& t, py::handle dtype, py::handle copy) {
            return array_protocol(view_of(t), dtype, copy);
          },
          "dtype"_a = py::none(), "copy"_a = py::none())
      .def(
          "__dlpack__",
          [](const Tensor& t, py::handle stream, py::handle max_version, py::handle dl_device,
             py::handle copy) {
            return export_dlpack(view_of(t), stream, max_version, dl_device, copy);
          },
          py::kw_only(), "stream"_a = py::none(), "max_version"_a = py::none(),
          "dl_device"_a = py::none(), "copy"_a = py::none())
      .def("__dlpack_device__", [](const Tensor& t) { return dlpack_device(view_of(t)); })
      .def_property_readonly(
          "__array_interface__",
          [](const Tensor& t) {
            if (!t.device().is_cpu())
              throw py::attribute_error("__array_interface__: the tensor is not on the cpu");
            return array_interface(view_of(t));
          })
      .def_property_readonly(
          "__cuda_array_interface__",
          [](const Tensor& t) {
            if (t.device().type != DeviceType::CUDA)
              throw py::attribute_error(
                  "__cuda_array_interface__: the tensor is not on a CUDA device");
            return cuda_array_interface(view_of(t));
          })
      .def("__repr__", &repr);
  // With __array_ufunc__ = None, NumPy leaves `array * tensor` to the tensor. Otherwise the result
  // would be an array without a gradient.
  c.attr("__array_ufunc__") = py::none();
}

// Binds an operator to a function of nova, for tensor-tensor and tensor-number operands.
#define NOVAPHY_OPERATOR(name, function)                                                       \
  c.def(                                                                                       \
       "__" #name "__", [](const Tensor& a, const Tensor& b) { return nova::function(a, b); }, \
       py::is_operator(), release_gil())                                                       \
      .def(                                                                                    \
          "__" #name "__", [](const Tensor& a, float b) { return nova::function(a, b); },      \
          py::is_operator(), release_gil())
#define NOVAPHY_REVERSED(name, expression)                                                     \
  c.def(                                                                                       \
      "__" #name "__", [](const Tensor& a, float b) { return expression; }, py::is_operator(), \
      release_gil())

#define NOVAPHY_COMPARISON(name, what)                                                          \
  c.def(                                                                                        \
       "__" #name "__",                                                                         \
       [](const Tensor& a, const Tensor& b) {                                                   \
         return nova::compare(nova::Comparison::what, a, b);                                    \
       },                                                                                       \
       py::is_operator(), release_gil())                                                        \
      .def(                                                                                     \
          "__" #name "__",                                                                      \
          [](const Tensor& a, float b) { return nova::compare(nova::Comparison::what, a, b); }, \
          py::is_operator(), release_gil())

void bind_operators(TensorClass& c) {
  NOVAPHY_OPERATOR(add, add);
  NOVAPHY_OPERATOR(sub, sub);
  NOVAPHY_OPERATOR(mul, mul);
  NOVAPHY_OPERATOR(truediv, div);
  NOVAPHY_REVERSED(radd, nova::add(a, b));
  NOVAPHY_REVERSED(rsub, nova::sub(b, a));
  NOVAPHY_REVERSED(rmul, nova::mul(a, b));
  NOVAPHY_REVERSED(rtruediv, nova::div(b, a));
  NOVAPHY_OPERATOR(pow, pow);
  NOVAPHY_REVERSED(rpow, nova::pow(b, a));
  NOVAPHY_COMPARISON(lt, Lt);
  NOVAPHY_COMPARISON(le, Le);
  NOVAPHY_COMPARISON(eq, Eq);
  NOVAPHY_COMPARISON(ne, Ne);
  NOVAPHY_COMPARISON(ge, Ge);
  NOVAPHY_COMPARISON(gt, Gt);
  // Without this overload, Python's == and != with an object that cannot be compared would be False
  // and True.
  for (const char* name : {"__eq__", "__ne__"})
    c.def(name, [name](const Tensor&, const py::object& other) -> py::object {
      require(!PyList_Check(other.ptr()) && !py::hasattr(other, "__array__"), ErrorKind::Type, name,
              ": expected a Tensor or a number, got ", type_name(other),
              "; make it a tensor with nova.tensor");
      return py::reinterpret_borrow<py::object>(Py_NotImplemented);
    });
  c.attr("__hash__") = py::module_::import("builtins").attr("object").attr("__hash__");
  c.def(
      "__matmul__", [](const Tensor& a, const Tensor& b) { return nova::matmul(a, b); },
      py::is_operator(), release_gil());
  c.def(
      "__neg__", [](const Tensor& t) { return nova::neg(t); }, release_gil());
  c.def(
      "__abs__", [](const Tensor& t) { return nova::abs(t); }, release_gil());
}

}  // namespace

void bind_nova_tensor(py::module_& m) {
  TensorClass c(m, "Tensor",
                "An n-dimensional array of float32, int32 or uint8 values on a device, with an "
                "optional gradient. Tensors over the same memory share the version and the "
                "gradient, and a tape detects overwritten values in all of them.");
  bind_properties(c);
  bind_methods(c);
  bind_operators(c);
  c.def(py::pickle(&keep, &unkept));
}

}  // namespace novaphy::python
