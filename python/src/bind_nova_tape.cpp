// Bindings of Tape, no_grad, captures (Graph, ScopedCapture), scan and gradcheck.
#include "doc_nova_tape.h"
#include "gradient_info.h"
#include "nova_types.h"
#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/scan.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

// with nova.no_grad(): ...  (may be nested)
class NoGradContext {
 public:
  void enter() { active_.push_back(std::make_unique<nova::NoGrad>()); }
  void exit() {
    if (!active_.empty()) active_.pop_back();
  }

 private:
  std::vector<std::unique_ptr<nova::NoGrad>> active_;
};

// with nova.ScopedCapture() as capture: ...; capture.graph.launch()
class CaptureContext {
 public:
  void enter() {
    require(capture_ == nullptr, ErrorKind::Runtime, "ScopedCapture: already active");
    capture_ = std::make_unique<nova::ScopedCapture>();
    graph_ = capture_->graph();
  }
  void exit() { capture_.reset(); }
  bool ran() const { return graph_ != nullptr; }
  const std::shared_ptr<nova::OpList>& graph() const {
    require(graph_ != nullptr, ErrorKind::Runtime,
            "ScopedCapture: nothing was captured; use it in a with statement");
    return graph_;
  }

 private:
  std::unique_ptr<nova::ScopedCapture> capture_;
  std::shared_ptr<nova::OpList> graph_;
};

void record_custom(nova::Tape& tape, const std::string& name, const std::vector<Tensor>& inputs,
                   const std::vector<Tensor>& outputs, const py::function& backward,
                   const std::optional<py::function>& forward) {
  const Callback callback{backward};
  nova::CustomOp op = nova::make_custom_op(
      name, inputs, outputs, [callback](const std::vector<Tensor>& grad_outputs) {
        const py::gil_scoped_acquire gil;
        py::list given;
        for (const Tensor& grad : grad_outputs) given.append(py::cast(grad));
        const py::object result = callback.get()(given);
        std::vector<Tensor> grads;
        if (py::isinstance<nova::TensorImpl>(result)) {
          grads.push_back(result.cast<Tensor>());
          return grads;
        }
        require(py::isinstance<py::sequence>(result), ErrorKind::Type,
                "record_custom, backward: expected it to return a list of gradients, got ",
                type_name(result));
        for (const py::handle grad : result) {
          require(grad.is_none() || py::isinstance<nova::TensorImpl>(grad), ErrorKind::Type,
                  "record_custom, backward: expected Tensors or None, got ", type_name(grad));
          grads.push_back(grad.is_none() ? Tensor() : grad.cast<Tensor>());
        }
        return grads;
      });
  if (forward)
    op.forward = [again = Callback{*forward}] {
      const py::gil_scoped_acquire gil;
      again.get()();
    };
  tape.record_custom(std::move(op));
}

GradientInfoFields tape_info(const nova::Tape& tape) { return to_fields(gradient_info(tape)); }
constexpr const char* kTapeInfo = doc::kTapeInfo;

void run_backward(nova::Tape& tape, const Tensor& loss, const std::optional<Tensor>& grad,
                  bool record) {
  if (record)
    backward_with_record(tape, loss, grad.value_or(Tensor()));
  else
    tape.backward(loss, grad.value_or(Tensor()));
}
py::list vector_of(const Vec3f& v) {
  py::list numbers;
  for (const float x : {v.x, v.y, v.z}) numbers.append(x);
  return numbers;
}
// Returns the AdjointRecord in Python: dicts of the steps, from the first step to the last.
py::object record_of(nova::Tape& tape, const std::optional<std::vector<Tensor>>& inputs) {
  const std::shared_ptr<const AdjointRecord> record = [&] {
    const py::gil_scoped_release release;
    return adjoint_record(tape, inputs.value_or(std::vector<Tensor>()));
  }();
  py::list steps;
  for (size_t k = record->steps.size(); k-- > 0;) {
    const AdjointRecord::Step& s = record->steps[k];
    py::list contacts;
    for (const AdjointRecord::Contact& c : s.contacts) {
      const auto row = static_cast<size_t>(c.row);
      const Vec3f change = row < s.changes.size() ? s.changes[row] : Vec3f{};
      const float moved = row < s.moved.size() ? s.moved[row] : 0.0f;
      contacts.append(py::dict("world"_a = c.world, "shape0"_a = c.shape0, "shape1"_a = c.shape1,
                               "point"_a = vector_of(c.point), "normal"_a = vector_of(c.normal),
                               "impulse"_a = vector_of(c.impulse),
                               "adjoint"_a = vector_of(c.adjoint), "change"_a = vector_of(change),
                               "held"_a = c.held, "particle"_a = c.particle, "moved"_a = moved));
    }
    steps.append(py::dict("number"_a = s.number, "dt"_a = s.dt, "start"_a = s.start,
                          "end"_a = s.end, "rates"_a = s.rates, "of_springs"_a = s.of_springs,
                          "contacts"_a = contacts));
  }
  return py::module_::import("novaphy.nova._adjoint_record")
      .attr("AdjointRecord")(steps, tape_info(tape));
}

void bind_tape(py::module_& m) {
  py::class_<nova::Tape>(m, "Tape", doc::kTape)
      .def(py::init([](bool leaf_gradients_only) {
             return std::make_unique<nova::Tape>(leaf_gradients_only ? nova::KeepGradients::Leaves
                                                                     : nova::KeepGradients::All);
           }),
           py::kw_only(), "leaf_gradients_only"_a = false)
      .def("__enter__",
           [](py::object self) {
             self.cast<nova::Tape&>().begin();
             return self;
           })
      .def("__exit__", [](nova::Tape& tape, const py::args&) { tape.end(); })
      .def("backward", &run_backward, "loss"_a, "grad"_a = py::none(), "record"_a = false,
           release_gil(), doc::kBackward)
      .def("adjoint_record", &record_of, "inputs"_a = py::none(), doc::kAdjointRecord)
      .def("jvp", &nova::Tape::jvp, "outputs"_a, "inputs"_a, "tangents"_a, release_gil(), doc::kJvp)
      .def(
          "follows",
          [](const nova::Tape& tape, const Tensor& tensor) {
            return tape.carries_gradient(*tensor.range());
          },
          "tensor"_a,
          "Returns whether this tape knows a derivative of the tensor: the tensor is a leaf, or "
          "the result of a recorded operation. A loss for backward() must be such a result.")
      .def("gradient_info", &tape_info, kTapeInfo)
      .def("zero", &nova::Tape::zero, release_gil(),
           "Sets all gradients to zero that this tape has written.")
      .def("reset", &nova::Tape::reset, "Removes all recorded operations.")
      .def_property_readonly("size", &nova::Tape::size, "The number of recorded operations.")
      .def("__len__", &nova::Tape::size)
      .def("__repr__",
           [](const nova::Tape& tape) {
             const std::vector<std::string> names = tape.op_names();
             std::string text = "Tape(size=" + std::to_string(names.size());
             if (!names.empty()) text += ", last='" + names.back() + "'";
             return text + ", memory_bytes=" + std::to_string(tape.memory_bytes()) + ")";
           })
      .def("op_names", &nova::Tape::op_names,
           "Returns the names of the recorded operations, in order.")
      .def_property_readonly("memory_bytes", &nova::Tape::memory_bytes,
                             "The memory of the recorded operations, without tensors (bytes).")
      .def("record_custom", &record_custom, "name"_a, "inputs"_a, "outputs"_a, "backward"_a,
           "forward"_a = py::none(), doc::kRecordCustom);

  m.def("active_tape", &nova::Tape::active, py::return_value_policy::reference, doc::kActiveTape);
  py::class_<NoGradContext>(
      m, "no_grad", "A context manager. Inside of it no tape records operations of this thread.")
      .def(py::init<>())
      .def("__enter__", &NoGradContext::enter)
      .def("__exit__", [](NoGradContext& c, const py::args&) { c.exit(); });
  m.def("grad_enabled", &nova::grad_enabled, "Returns whether this thread is outside of no_grad.");
}

std::string graph_text(const nova::OpList& graph) {
  return "Graph(size=" + std::to_string(graph.size()) + ")";
}

void bind_capture(py::module_& m) {
  py::class_<nova::OpList, std::shared_ptr<nova::OpList>>(
      m, "Graph", "A recorded list of operations on fixed memory, which launch() runs.")
      .def("launch", &nova::OpList::launch, release_gil(), doc::kGraphLaunch)
      .def("prepare", &nova::OpList::prepare, release_gil(),
           "Plans and compiles the graph without running it, so that the first launch is fast. "
           "Call prepare before measurements of time. novaphy.Error: inside of a ScopedCapture.")
      .def("__len__", &nova::OpList::size)
      .def("__repr__", &graph_text)
      .def_property_readonly("size", &nova::OpList::size, "The number of operations.");
  py::class_<CaptureContext>(
      m, "ScopedCapture",
      "A context manager that records the launches, copies and fills of this thread into a Graph, "
      "without running them. Raises novaphy.Error if the host reads values, or an operation cannot "
      "be recorded.")
      .def(py::init<>())
      .def("__enter__",
           [](py::object self) {
             self.cast<CaptureContext&>().enter();
             return self;
           })
      .def("__exit__", [](CaptureContext& c, const py::args&) { c.exit(); })
      .def("__repr__",
           [](const CaptureContext& c) {
             return "ScopedCapture(" + (c.ran() ? "graph=" + graph_text(*c.graph()) : "") + ")";
           })
      .def_property_readonly("graph", &CaptureContext::graph, "The Graph of the capture.");
  m.def(
      "capture_launch", [](const nova::OpList& graph) { graph.launch(); }, "graph"_a, release_gil(),
      "Runs graph.launch().");
  const py::cpp_function wait(&nova::wait_for_compilers, release_gil());
  py::module_::import("atexit").attr("register")(wait);
}

// scan over lists of tensors; novaphy.nova.scan takes and returns structures of tensors. `body`
// returns a pair of lists.
void bind_scan(py::module_& m) {
  m.def(
      "_scan",
      [](const py::function& body, const std::vector<Tensor>& carry, const std::vector<Tensor>& xs,
         std::optional<int64_t> length) {
        using Lists = std::pair<std::vector<Tensor>, std::vector<Tensor>>;
        const auto step = [&](const std::vector<Tensor>& c, const std::vector<Tensor>& x) {
          const py::gil_scoped_acquire gil;
          Lists results = body(c, x).cast<Lists>();
          return nova::ScanResult{std::move(results.first), std::move(results.second)};
        };
        const ReleasedGil released;
        nova::ScanResult found = nova::scan(step, carry, xs, length);
        return Lists{std::move(found.carry), std::move(found.ys)};
      },
      "body"_a, "carry"_a, "xs"_a, "length"_a);
}

void bind_gradcheck(py::module_& m) {
  const nova::GradcheckOptions d;
  py::class_<nova::GradcheckResult>(m, "GradcheckResult",
                                    "The result of gradcheck. bool() is True if all values agree.")
      .def_readonly("ok", &nova::GradcheckResult::ok, "Whether all values agree.")
      .def_readonly("max_abs_error", &nova::GradcheckResult::max_abs_error,
                    "The largest difference between the gradient and the difference quotient.")
      .def_readonly("max_rel_error", &nova::GradcheckResult::max_rel_error,
                    "The largest difference between gradient and difference quotient of an input, "
                    "relative to "
                    "the largest difference quotient of the input.")
      .def_readonly("worst", &nova::GradcheckResult::worst,
                    "A text about the largest difference, such as \"input 1, value 4: ad 0.5, fd "
                    "0.4\" (ad: gradient, fd: difference quotient).")
      .def_readonly("has_tangent", &nova::GradcheckResult::has_tangent,
                    "Whether every operation has a tangent, so that the dot product was compared.")
      .def_readonly(
          "dot_product_error", &nova::GradcheckResult::dot_product_error,
          "The difference between two derivatives along one random direction u: J u (Tape.jvp) and "
          "the dot product of u and the gradient. Relative to the sum of |u_i gradient_i|.")
      .def("__bool__", [](const nova::GradcheckResult& r) { return r.ok; })
      .def("__repr__", [](const nova::GradcheckResult& r) {
        return std::string("GradcheckResult(ok=") + (r.ok ? "True" : "False") +
               ", max_rel_error=" + std::to_string(r.max_rel_error) + ", dot_product_error=" +
               (r.has_tangent ? std::to_string(r.dot_product_error) : "None") + ", worst='" +
               r.worst + "')";
      });
  m.def(
      "gradcheck",
      [](const py::function& fn, const std::vector<Tensor>& inputs, float epsilon, float rtol,
         float atol, float dot_product_tolerance) {
        const auto call = [&fn](const std::vector<Tensor>& tensors) {
          const py::object loss = fn(*py::tuple(py::cast(tensors)));
          require(py::isinstance<nova::TensorImpl>(loss), ErrorKind::Type,
                  "gradcheck, fn: expected it to return a Tensor, got ", type_name(loss));
          return loss.cast<Tensor>();
        };
        return nova::gradcheck(call, inputs,
                               {.epsilon = epsilon,
                                .rtol = rtol,
                                .atol = atol,
                                .dot_product_tolerance = dot_product_tolerance});
      },
      "fn"_a, "inputs"_a, py::kw_only(), "epsilon"_a = d.epsilon, "rtol"_a = d.rtol,
      "atol"_a = d.atol, "dot_product_tolerance"_a = d.dot_product_tolerance, doc::kGradcheck);
}

}  // namespace

void bind_nova_tape(py::module_& m) {
  bind_tape(m);
  bind_capture(m);
  bind_scan(m);
  bind_gradcheck(m);
}

}  // namespace novaphy::python
