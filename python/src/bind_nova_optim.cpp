// Bindings of optimizers (SGD, Adam) and of gradient clipping.
#include "doc_nova_optim.h"
#include "nova_types.h"
#include "novaphy/nova/optim.h"

namespace novaphy::python {

using nova::Tensor;
using nova::optim::Adam;
using nova::optim::SGD;

namespace {

// Reads parameters: a Tensor, or an iterable of Tensors.
std::vector<Tensor> to_params(py::handle value, const char* call) {
  if (py::isinstance<nova::TensorImpl>(value)) return {value.cast<Tensor>()};
  require(py::isinstance<py::iterable>(value), ErrorKind::Type, call,
          ", params: expected a list of Tensors, got ", type_name(value));
  std::vector<Tensor> params;
  for (const py::handle item : value) {
    require(py::isinstance<nova::TensorImpl>(item), ErrorKind::Type, call, ", params[",
            params.size(), "]: expected a Tensor, got ", type_name(item));
    params.push_back(item.cast<Tensor>());
  }
  return params;
}

void bind_updates(py::module_& m) {
  m.def("sgd_update_f32", &nova::sgd_update_f32, "param"_a, "learning_rate"_a, release_gil(),
        "Updates param -= learning_rate * param.grad in place, by one kernel. ValueError: param "
        "has no gradient.");
  m.def("sgd_update_vec3_clipped_f32", &nova::sgd_update_vec3_clipped_f32, "param"_a,
        "learning_rate"_a, "max_parameter_norm"_a, "max_gradient_norm"_a, release_gil(),
        doc::kClippedSgd);
  const nova::AdamOptions d;
  m.def("adam_update_f32", &nova::adam_update_f32, "param"_a, "m"_a, "v"_a, "t"_a, "lr"_a,
        "beta1"_a = d.beta1, "beta2"_a = d.beta2, "eps"_a = d.eps, release_gil(),
        R"(Updates param in place by one step of Adam with g = param.grad (Kingma and Ba 2015,
Algorithm 1):

    t += 1;  m = beta1 * m + (1 - beta1) * g;  v = beta2 * v + (1 - beta2) * g * g
    param -= lr * (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + eps)

param: float32 of any shape.
m, v: the moments, of the same shape; zeros before the first step.
t: the number of steps so far {1}; zero before the first step. The kernel increments t, so each
launch of a captured graph is a step. Every parameter needs a separate t.
lr: finite and >= 0, in units of param.
beta1, beta2: in [0, 1).
eps: finite and > 0, in units of the gradient.

TypeError: a tensor is not float32.
ValueError, before anything is written: param has no gradient, a shape does not fit, two tensors
share memory, or a number is out of range.)");
}

void bind_clipping(py::module_& m) {
  m.def(
      "clip_grad_norm_",
      [](py::handle params, float max_norm) {
        const std::vector<Tensor> list = to_params(params, "clip_grad_norm_");
        const ReleasedGil release;
        return nova::clip_grad_norm_(list, max_norm);
      },
      "params"_a, "max_norm"_a, doc::kClipNorm);
  m.def(
      "clip_grad_value_",
      [](py::handle params, float v) {
        const std::vector<Tensor> list = to_params(params, "clip_grad_value_");
        const ReleasedGil release;
        nova::clip_grad_value_(list, v);
      },
      "params"_a, "v"_a,
      "Clamps every value of the gradients to [-v, v], in place. NaN stays NaN. ValueError: a "
      "parameter has no gradient or is given twice, there are no parameters, or v is <= 0 or NaN. "
      "TypeError: a parameter is not float32.");
  m.def("clamp_", &nova::clamp_, "param"_a, "lo"_a, "hi"_a, release_gil(),
        "Clamps every value of param to [lo, hi], in place. A tape does not record the call. NaN "
        "stays NaN. ValueError: lo > hi or NaN. TypeError: param is not float32.");
}

// Binds the members that SGD and Adam share.
template <class C>
void bind_optimizer(py::class_<C>& c) {
  c.def("__repr__",
        [](const py::object& self) {
          const C& optimizer = self.cast<const C&>();
          std::string shapes;
          for (const Tensor& p : optimizer.params())
            shapes += (shapes.empty() ? "" : ", ") + shape_text(p.shape());
          return std::string(py::str(py::type::of(self).attr("__name__"))) + "(params=[" + shapes +
                 "], lr=" + number_text(optimizer.lr()) + ")";
        })
      .def("step", &C::step, release_gil(), doc::kOptimizerStep)
      .def("check", &C::check, release_gil(),
           "Waits for the device. novaphy.Error: since the last call of check, a step had a "
           "gradient that is not finite.")
      .def("zero_grad", &C::zero_grad, release_gil(), "Sets the gradients to zero.")
      .def_property_readonly("params", &C::params, "The parameters, as a list.")
      .def_property("lr", &C::lr, &C::set_lr,
                    "The learning rate of the next steps. A captured graph uses the learning rate "
                    "of its capture. ValueError: the value is not finite or < 0.");
}

void bind_classes(py::module_& m) {
  const nova::SGDOptions s;
  py::class_<SGD> sgd(m, "SGD",
                      R"(Gradient descent with momentum, as in PyTorch and Warp. A step of a
parameter p with the gradient g and the momentum buffer b:

    g += weight_decay * p;  b = momentum * b + (1 - dampening) * g, in the first step b = g
    g = g + momentum * b if nesterov else b;  p -= lr * g

params: a list of different float32 Tensors of one device.
lr: finite and >= 0, in units of param^2 / loss.
momentum, weight_decay: finite and >= 0.
nesterov: needs a momentum > 0 and no dampening.

ValueError, TypeError: an argument is not valid; the message names the argument.)");
  sgd.def(py::init([](py::handle params, float lr, float momentum, float dampening,
                      float weight_decay, bool nesterov) {
            return std::make_unique<SGD>(
                to_params(params, "SGD"),
                nova::SGDOptions{lr, momentum, dampening, weight_decay, nesterov});
          }),
          "params"_a, "lr"_a = s.lr, "momentum"_a = s.momentum, "dampening"_a = s.dampening,
          "weight_decay"_a = s.weight_decay, "nesterov"_a = s.nesterov)
      .def_property_readonly("b", &SGD::b,
                             "The momentum buffers b of the parameters; an empty list if momentum "
                             "is 0.")
      .def_property_readonly("t", &SGD::t,
                             "The number of steps so far {1}; None if momentum is 0.");
  bind_optimizer(sgd);

  const nova::AdamOptions a;
  py::class_<Adam> adam(
      m, "Adam",
      R"(The optimizer Adam (Kingma and Ba 2015, Algorithm 1). See adam_update_f32 for the formulas.

params: a list of different float32 Tensors of one device.
lr: finite and >= 0, in units of param.
betas: (beta1, beta2), both in [0, 1).
eps: finite and > 0, in units of the gradient.

ValueError, TypeError: an argument is not valid; the message names the argument.)");
  adam.def(py::init([](py::handle params, float lr, std::pair<float, float> betas, float eps) {
             return std::make_unique<Adam>(to_params(params, "Adam"),
                                           nova::AdamOptions{lr, betas.first, betas.second, eps});
           }),
           "params"_a, "lr"_a = a.lr, "betas"_a = std::pair(a.beta1, a.beta2), "eps"_a = a.eps)
      .def_property_readonly("m", &Adam::m, "A list with the first moment m of each parameter.")
      .def_property_readonly("v", &Adam::v, "A list with the second moment v of each parameter.")
      .def_property_readonly("t", &Adam::t, "The number of steps so far, {1}.");
  bind_optimizer(adam);
}

}  // namespace

void bind_nova_optim(py::module_& m) {
  bind_updates(m);
  bind_clipping(m);
  bind_classes(m);
}

}  // namespace novaphy::python
