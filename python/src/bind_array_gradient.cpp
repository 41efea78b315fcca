// Gradients as properties of DeviceArray, such as state.particle_q.grad.
#include "nova_types.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

// Returns whether the array can have a gradient. The tensor runtime only knows float32 arrays, and
// an empty array has no memory to attach a gradient to.
bool has_gradients(const Array& array) {
  return dtype_info(array.dtype()).scalar == Scalar::F32 && array.rows() != 0;
}

py::object array_grad(const Array& array) {
  if (!has_gradients(array)) return py::none();
  const Tensor tensor = Tensor::view(array);
  if (!(tensor.requires_grad() || tensor.has_grad())) return py::none();
  return py::cast(Array(array.dtype(), array.rows(), array.width(), tensor.grad().range()));
}

}  // namespace

void bind_array_gradient(py::class_<Array>& array) {
  array.def_property_readonly(
      "grad", &array_grad,
      "The gradient of a loss by the values, a DeviceArray of the same shape. None: the array "
      "requires no gradient. Before the first backward pass the gradient is zero. A Tensor over "
      "the same memory has the same gradient.");
  array.def_property(
      "requires_grad",
      [](const Array& a) { return has_gradients(a) && Tensor::view(a).requires_grad(); },
      [](const Array& a, bool on) {
        require(dtype_info(a.dtype()).scalar == Scalar::F32, ErrorKind::Value,
                "requires_grad: only float32 values have gradients, these are ",
                dtype_info(a.dtype()).name);
        if (has_gradients(a)) Tensor::view(a).set_requires_grad(on);
      },
      "Whether the array is a leaf: an input for which backward computes a gradient. Any float32 "
      "array can be a leaf. If a state has requires_grad, its positions and velocities become "
      "leaves when a tape records a step.");
}

}  // namespace novaphy::python
