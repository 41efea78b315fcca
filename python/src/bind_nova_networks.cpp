// Bindings of activations, linear layers, and counter-based random numbers.
#include "doc_nova_networks.h"
#include "nova_types.h"
#include "novaphy/math/activations.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/networks.h"
#include "part_bindings.h"

namespace novaphy::python {

using nova::Real;
using nova::Tensor;

namespace {

using Draw = Tensor (*)(int64_t, int64_t, const nova::RandomKey&, const Tensor&);

int64_t to_int64(py::handle value, const char* name) {
  const auto index = py::reinterpret_steal<py::object>(PyNumber_Index(value.ptr()));
  if (!index) {
    PyErr_Clear();
    fail(ErrorKind::Type, name, ": expected an integer, got ", type_name(value));
  }
  int overflow = 0;
  const long long number = PyLong_AsLongLongAndOverflow(index.ptr(), &overflow);
  require(overflow == 0, ErrorKind::Value, name, ": expected an int64, got ",
          std::string(py::str(index)));
  return number;
}

uint64_t to_seed(py::handle value) {
  const auto index = py::reinterpret_steal<py::object>(PyNumber_Index(value.ptr()));
  if (!index) {
    PyErr_Clear();
    fail(ErrorKind::Type, "seed: expected an integer, got ", type_name(value));
  }
  const unsigned long long number = PyLong_AsUnsignedLongLong(index.ptr());
  if (PyErr_Occurred() != nullptr) {
    PyErr_Clear();
    fail(ErrorKind::Value, "seed: expected an integer from 0 to 2^64 - 1, got ",
         std::string(py::str(index)));
  }
  return number;
}

std::pair<int64_t, int64_t> to_draw_shape(py::handle value) {
  const bool is_pair =
      py::isinstance<py::sequence>(value) && !py::isinstance<py::str>(value) && py::len(value) == 2;
  require(is_pair, ErrorKind::Value, "shape: expected {worlds, width}, two integers, got ",
          std::string(py::repr(value)));
  const auto pair = py::reinterpret_borrow<py::sequence>(value);
  const py::object worlds = pair[0], width = pair[1];
  return {to_int64(worlds, "shape[0]"), to_int64(width, "shape[1]")};
}

void bind_draw(py::module_& m, const char* name, Draw draw, const char* doc) {
  m.def(
      name,
      [draw](py::handle shape, py::handle seed, py::handle step, py::handle stream,
             py::handle device, py::handle first_world) {
        const auto [worlds, width] = to_draw_shape(shape);
        const nova::RandomKey key{.seed = to_seed(seed),
                                  .stream = to_int32(stream, "stream"),
                                  .first_world = to_int32(first_world, "first_world")};
        Tensor at;
        if (py::isinstance<nova::TensorImpl>(step)) {
          at = step.cast<Tensor>();
          require(device.is_none() || to_device(device) == at.device(), ErrorKind::Value,
                  "device: expected that of step, ", at.device().str());
        } else {
          const int32_t number = to_int32(step, "step");
          at = Tensor::from_host(std::span(&number, 1), {1}, to_device(device));
        }
        const ReleasedGil released;
        return draw(worlds, width, key, at);
      },
      "shape"_a, py::kw_only(), "seed"_a, "step"_a = 0, "stream"_a = 0, "device"_a = py::none(),
      "first_world"_a = 0, doc);
}

}  // namespace

void bind_nova_networks(py::module_& m) {
  m.def("relu", &nova::relu, "x"_a, release_gil(),
        "Returns max(x, 0). The derivative is 1 above 0, else 0.");
  m.def(
      "relu", [](const Real& x) { return novaphy::math::relu(x); }, "x"_a);
  m.def("softplus", &nova::softplus, "x"_a, release_gil(),
        "Returns log(1 + e^x), computed without overflow. The derivative is 1 / (1 + e^-x).");
  m.def(
      "softplus", [](const Real& x) { return novaphy::math::softplus(x); }, "x"_a);
  m.def(
      "linear",
      [](const Tensor& x, const Tensor& weight, const std::optional<Tensor>& bias) {
        return nova::linear(x, weight, bias.value_or(Tensor()));
      },
      "x"_a, "weight"_a, "bias"_a = py::none(), release_gil(),
      "Returns x weight^T + bias, {n, m} or {m}, for x {n, k} or {k}, weight {m, k} and bias {m} "
      "(None: no bias). Sums are added in the order of matmul.");
  bind_draw(m, "random_uniform", &nova::random_uniform, doc::kUniform);
  bind_draw(m, "random_normal", &nova::random_normal,
            "Returns normal random numbers {worlds, width} with mean 0 and variance 1, by the "
            "Box-Muller transform of Philox numbers. For the arguments see random_uniform. No "
            "gradient.");
  m.def("philox4x32", &nova::philox4x32, "counter"_a, "key"_a,
        "Returns the four 32-bit words of the generator Philox4x32-10 for a counter of four words "
        "and a key of two words (Salmon et al. 2011).");
}

}  // namespace novaphy::python
