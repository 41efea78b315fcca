// Optimizers and clipping.
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
        "Updates param -= learning_rate * param.grad in place, as one kernel. ValueError: no "
        "gradient.");
  m.def("sgd_update_vec3_clipped_f32", &nova::sgd_update_vec3_clipped_f32, "param"_a,
        "learning_rate"_a, "max_parameter_norm"_a, "max_gradient_norm"_a, release_gil(),
        doc::kClippedSgd);
  const nova::AdamOptions d;
  m.def("adam_update_f32", &nova::adam_update_f32, "param"_a, "m"_a, "v"_a, "t"_a, "lr"_a,
        "beta1"_a = d.beta1, "beta2"_a = d.beta2, "eps"_a = d.eps, release_gil(),
        R"(Takes one step of Adam, in place, from param.grad (Kingma and Ba 2015, Algorithm 1):

    t += 1;  m = beta1 * m + (1 - beta1) * g;  v = beta2 * v + (1 - beta2) * g * g
    param -= lr * (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + eps)

param: float32 of any shape.
m, v: zeros of that shape before the first step.
t: zeros(1), the number of steps so far. A kernel raises t, so each launch of a captured graph is a
step. Give every parameter a t of its own.
lr: finite and >= 0, in units of param.
beta1, beta2: in [0, 1).
eps: finite and > 0, in units of the gradient.

TypeError: not float32.
ValueError: no gradient, a wrong shape, memory given twice, a number out of range. Nothing was
written then.)");
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
      "Limits every value of the gradients to [-v, v], in place. NaN stays NaN. ValueError: a "
      "parameter without gradient or given twice, no parameters, v <= 0 or NaN. TypeError: not "
      "float32.");
  m.def("clamp_", &nova::clamp_, "param"_a, "lo"_a, "hi"_a, release_gil(),
        "Limits every value of param to [lo, hi], in place and without a record on a tape. NaN "
        "stays NaN. ValueError: not lo <= hi. TypeError: not float32.");
}

// The common members of both classes.
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
           "Waits for the device. novaphy.Error: since the last call a step met a gradient that is "
           "not finite.")
      .def("zero_grad", &C::zero_grad, release_gil(), "Sets the gradients to zero.")
      .def_property_readonly("params", &C::params, "The parameters, as a list.")
      .def_property("lr", &C::lr, &C::set_lr,
                    "The learning rate of the next steps. A captured graph keeps its own. "
                    "ValueError: not finite, or < 0.");
}

void bind_classes(py::module_& m) {
  const nova::SGDOptions s;
  py::class_<SGD> sgd(m, "SGD",
                      R"(Gradient descent with momentum, as in PyTorch and Warp:

    g += weight_decay * p;  b = momentum * b + (1 - dampening) * g, in the first step b = g
    g = g + momentum * b if nesterov else b;  p -= lr * g

params: a list of float32 Tensors of one device, none of them twice.
lr: finite and >= 0, in units of param^2 / loss.
momentum, weight_decay: finite and >= 0.
nesterov: needs a momentum > 0 and no dampening.

ValueError and TypeError name the argument.)");
  sgd.def(py::init([](py::handle params, float lr, float momentum, float dampening,
                      float weight_decay, bool nesterov) {
            return std::make_unique<SGD>(
                to_params(params, "SGD"),
                nova::SGDOptions{lr, momentum, dampening, weight_decay, nesterov});
          }),
          "params"_a, "lr"_a = s.lr, "momentum"_a = s.momentum, "dampening"_a = s.dampening,
          "weight_decay"_a = s.weight_decay, "nesterov"_a = s.nesterov)
      .def_property_readonly("b", &SGD::b,
                             "The momentum of each parameter; an empty list without momentum.")
      .def_property_readonly("t", &SGD::t,
                             "The number of steps so far, {1}; None without momentum.");
  bind_optimizer(sgd);

  const nova::AdamOptions a;
  py::class_<Adam> adam(
      m, "Adam",
      R"(Adam (Kingma and Ba 2015, Algorithm 1): adam_update_f32 of every parameter.

params: a list of float32 Tensors of one device, none of them twice.
lr: finite and >= 0, in units of param.
betas: in [0, 1).
eps: finite and > 0, in units of the gradient.

ValueError and TypeError name the argument.)");
  adam.def(py::init([](py::handle params, float lr, std::pair<float, float> betas, float eps) {
             return std::make_unique<Adam>(to_params(params, "Adam"),
                                           nova::AdamOptions{lr, betas.first, betas.second, eps});
           }),
           "params"_a, "lr"_a = a.lr, "betas"_a = std::pair(a.beta1, a.beta2), "eps"_a = a.eps)
      .def_property_readonly("m", &Adam::m, "The first moment of each parameter.")
      .def_property_readonly("v", &Adam::v, "The second moment of each parameter.")
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
