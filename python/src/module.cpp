// The module novaphy._core: errors, signals, build information, and calls of the bind_ functions.
// The order of the calls matters, because bindings need classes of earlier ones.
#include <new>

#include "fast_step.h"
#include "gradient_info.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/version.h"
#include "novaphy/core/warning.h"
#include "part_bindings.h"

namespace novaphy::python {

void bind_host_buffer(py::module_& m);

namespace {

PyObject* error_type = nullptr;  // novaphy.Error, never released

PyObject* python_type(ErrorKind kind) {
  switch (kind) {
    case ErrorKind::Value:
      return PyExc_ValueError;
    case ErrorKind::Type:
      return PyExc_TypeError;
    case ErrorKind::Index:
      return PyExc_IndexError;
    case ErrorKind::NotImplemented:
      return PyExc_NotImplementedError;
    case ErrorKind::Runtime:
      break;
  }
  return error_type;
}

// Sets a Python error. Bytes of the text that are not UTF-8, for example from a path, are replaced.
void raise(PyObject* type, std::string_view text) {
  const auto size = static_cast<Py_ssize_t>(text.size());
  const auto message =
      py::reinterpret_steal<py::object>(PyUnicode_DecodeUTF8(text.data(), size, "replace"));
  if (message) PyErr_SetObject(type, message.ptr());
}

void bind_errors(py::module_& m) {
  error_type = PyErr_NewExceptionWithDoc("novaphy.Error",
                                         "Misuse of a device, a backend, a tape or a capture.",
                                         PyExc_RuntimeError, nullptr);
  if (error_type == nullptr) throw py::error_already_set();
  m.attr("Error") = py::handle(error_type);
  py::register_exception_translator([](std::exception_ptr pointer) {
    try {
      if (pointer) std::rethrow_exception(pointer);
    } catch (const Error& error) {
      raise(python_type(error.kind()), error.what());
    }
  });
}

void make_warning(const std::string& text) {
  if (!Py_IsInitialized()) return;
  const py::gil_scoped_acquire gil;
  if (PyErr_WarnEx(PyExc_RuntimeWarning, text.c_str(), 1) != 0) throw py::error_already_set();
}

// Handles Ctrl-C in a long native loop: throws if a signal handler raised, on Python's main thread.
// On other threads it throws if the exit of the interpreter waits for this thread, to end the work.
void check_signals() {
  if (!Py_IsInitialized()) return;
  const py::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  if (exit_waits_for_me()) {  // SystemExit ends a thread without a message
    PyErr_SetNone(PyExc_SystemExit);
    throw py::error_already_set();
  }
}

constexpr std::pair<const char*, bool> kBuildInfo[] = {
#include "build_info.inc"
};

bool built_with(std::string_view option) {
  for (const auto& [name, on] : kBuildInfo)
    if (option == name) return on;
  return false;
}

void bind_build(py::module_& m) {
  m.def(
      "version", [] { return std::string(version()); },
      "Returns the version of the engine, such as \"0.1.0\".");
  m.def(
      "build_info",
      [] {
        py::dict info;
        for (const auto& [name, on] : kBuildInfo) info[name] = on;
        return info;
      },
      "Returns a dict of the CMake options of this build: name -> bool.");
  m.def(
      "has_cuda", [] { return device_available(Device::cuda()); },
      "Returns whether a CUDA device is available.");
  m.def(
      "has_diff", [] { return built_with("NOVAPHY_WITH_DIFF"); },
      "Returns whether novaphy.nova and novaphy.diff are built.");
  m.def(
      "has_io", [] { return built_with("NOVAPHY_WITH_IO"); },
      "Returns whether novaphy.io.load_mesh, ModelBuilder.add_urdf and add_mjcf are built.");
  m.def(
      "has_vbd", [] { return built_with("NOVAPHY_BUILD_VBD"); },
      "Returns whether the VBD solver is built.");
  m.def(
      "has_nvrtc", [] { return built_with("NOVA_ENABLE_NVRTC"); },
      "Returns whether run-time compilation of kernels (NVRTC) is built.");
  m.def("num_threads", &num_threads, "Returns the number of CPU threads that the engine uses.");
  m.def("set_num_threads", &set_num_threads, "count"_a, release_gil(),
        "Sets the number of CPU threads that the engine uses, 1 to 1024 (else ValueError). The "
        "bits of results do not depend on this number.");
}

}  // namespace

void set_python_error(const std::exception_ptr& error) {
  try {
    std::rethrow_exception(error);
  } catch (py::error_already_set& e) {
    e.restore();
  } catch (const Error& e) {
    raise(python_type(e.kind()), e.what());
  } catch (const std::bad_alloc&) {
    PyErr_NoMemory();
  } catch (const std::exception& e) {
    raise(PyExc_RuntimeError, e.what());
  }
}

PYBIND11_MODULE(_core, m) {
  m.doc() = "The engine of NovaPhy. Import novaphy, not this module.";
  py::options options;
  options.disable_enum_members_docstring();
  bind_errors(m);
  bind_build(m);
  bind_host_buffer(m);
  bind_core(m);
  bind_array(m);
  bind_enums(m);
  bind_sim(m);
  bind_builder(m);
  bind_collision(m);
  py::module_ solvers = m.def_submodule("solvers", "Solvers; import novaphy.solvers.");
#ifdef NOVAPHY_PYTHON_DIFF
  bind_gradient_info(solvers);
#endif
  bind_dynamics(m, solvers);
#ifdef NOVAPHY_PYTHON_VBD
  bind_vbd(solvers);
#endif
  py::module_ io = m.def_submodule("io", "Meshes and robots from files; import novaphy.io.");
  bind_io(io);
  auto builder = py::class_<ModelBuilder>(m.attr("ModelBuilder"));
  bind_robots(builder, io);
#ifdef NOVAPHY_PYTHON_DIFF
  py::module_ nova = m.def_submodule("nova", "The tensor runtime; import novaphy.nova.");
  bind_nova_tensor(nova);
  bind_nova(nova);
  bind_nova_tape(nova);
  bind_nova_optim(nova);
  bind_nova_trace(nova);
  bind_nova_kernel(nova);
  bind_nova_networks(nova);
  py::module_ diff = m.def_submodule("diff", "Differentiable operators; import novaphy.diff.");
  bind_diff(diff, solvers);
  bind_event_times(diff);
#endif
  explain_argument_errors(m);
  set_interrupt_check(&check_signals);
  set_warning_handler(&make_warning);
  wait_at_exit();
}

}  // namespace novaphy::python
