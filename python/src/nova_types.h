// Tensors in Python. An object of the class nova.Tensor holds the shared TensorImpl, so a tensor is
// the same Python object during its lifetime.
#pragma once

#include "exchange.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "novaphy/nova/tensor.h"

namespace pybind11::detail {

template <>
struct type_caster<nova::Tensor> {
  PYBIND11_TYPE_CASTER(nova::Tensor, const_name("novaphy._core.nova.Tensor"));

  bool load(handle source, bool convert) {
    make_caster<std::shared_ptr<nova::TensorImpl>> impl;
    if (source.is_none() || !impl.load(source, convert)) return false;
    value = nova::Tensor(cast_op<std::shared_ptr<nova::TensorImpl>>(impl));
    return true;
  }
  static handle cast(const nova::Tensor& tensor, return_value_policy, handle) {
    if (!tensor.defined()) return none().release();
    return make_caster<std::shared_ptr<nova::TensorImpl>>::cast(tensor.impl(),
                                                                return_value_policy::automatic, {});
  }
};

}  // namespace pybind11::detail

namespace novaphy::python {

// Converts a const method of Tensor to a function, because the class that pybind11 binds is
// TensorImpl.
template <auto F>
struct Method;
template <class R, class... Args, R (nova::Tensor::*F)(Args...) const>
struct Method<F> {
  static R call(const nova::Tensor& self, Args... args) { return (self.*F)(args...); }
};
template <auto F>
inline constexpr auto method = &Method<F>::call;

nova::DType to_nova_dtype(py::handle value);
DType dtype_of(nova::DType dtype);
View view_of(const nova::Tensor& tensor);
nova::Tensor tensor_of(const View& view);
// Returns a Tensor unchanged, or a number as a tensor {1} on the device. TypeError: another type.
nova::Tensor to_operand(py::handle value, const char* name, const Device& device);
// Returns x[key], recorded on an active tape. IndexError: an index is out of range. TypeError:
// `key` is no index.
nova::Tensor get_item(const nova::Tensor& x, py::handle key);

// Reductions over all values, or along one dimension. ValueError: keepdims without an axis.
enum class Reduction { Sum, Mean, Max, Min };
template <Reduction R>
nova::Tensor reduced(const nova::Tensor& x, std::optional<int64_t> axis, bool keepdims);

// A Python callable that native code may call and release on any thread.
class Callback {
 public:
  explicit Callback(py::object function)
      : function_(new py::object(std::move(function)), [](py::object* f) {
          if (!Py_IsInitialized()) return;
          const py::gil_scoped_acquire gil;
          delete f;
        }) {}
  const py::object& get() const { return *function_; }  // needs the GIL

 private:
  std::shared_ptr<py::object> function_;
};

}  // namespace novaphy::python
