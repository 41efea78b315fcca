// solver.step as a plain C function, because pybind11's argument conversion costs more than the
// step of a small model. The fast path takes five positional arguments of the engine's own classes.
// All other calls use the general binding of pybind11.
#pragma once

#include <exception>
#include <type_traits>
#include <vector>

#include "convert.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/core/sim/solver_base.h"

namespace novaphy::python {

// Sets the Python error that pybind11 would raise for a C++ exception.
void set_python_error(const std::exception_ptr& error);

// Finds the C++ object in an instance of exactly the bound class T; null for any other object.
template <class T>
struct BoundClass {
  static inline PyTypeObject* type = nullptr;
  static void remember(py::handle cls) { type = reinterpret_cast<PyTypeObject*>(cls.ptr()); }
  static T* pointer(PyObject* object) {
    if (Py_TYPE(object) != type) return nullptr;
    const auto slot = reinterpret_cast<py::detail::instance*>(object)->get_value_and_holder();
    return static_cast<T*>(slot.value_ptr());
  }
};

struct GeneralStep {
  static inline PyObject* function = nullptr;  // SolverBase.step, never released
};

template <class Solver>
PyObject* fast_step(PyObject* self, PyObject* const* args, Py_ssize_t count, PyObject* keywords) {
  Solver* solver = nullptr;
  SimState *in = nullptr, *out = nullptr;
  const Control* control = nullptr;
  const Contacts* contacts = nullptr;
  const auto ready = [&] {
    if (keywords != nullptr || count != 5 || !PyFloat_CheckExact(args[4])) return false;
    solver = BoundClass<Solver>::pointer(self);
    in = BoundClass<SimState>::pointer(args[0]);
    out = BoundClass<SimState>::pointer(args[1]);
    control = args[2] == Py_None ? nullptr : BoundClass<Control>::pointer(args[2]);
    contacts = args[3] == Py_None ? nullptr : BoundClass<Contacts>::pointer(args[3]);
    return solver != nullptr && in != nullptr && out != nullptr &&
           (args[2] == Py_None) == (control == nullptr) &&
           (args[3] == Py_None) == (contacts == nullptr);
  };
  if (!ready()) {
    const Py_ssize_t names = keywords != nullptr ? PyTuple_GET_SIZE(keywords) : 0;
    std::vector<PyObject*> all = {self};
    all.insert(all.end(), args, args + count + names);
    return PyObject_Vectorcall(GeneralStep::function, all.data(), static_cast<size_t>(count) + 1,
                               keywords);
  }
  const auto dt = static_cast<float>(PyFloat_AS_DOUBLE(args[4]));
  std::exception_ptr error;
  {
    const ReleasedGil released;
    try {
      solver->step(*in, *out, control, contacts, dt);
    } catch (...) {
      error = std::current_exception();
    }
  }
  if (error) {
    set_python_error(error);
    return nullptr;
  }
  Py_RETURN_NONE;
}

// Replaces the method `step` of a solver class by the fast one.
template <class Solver, class... Options>
void add_fast_step(py::class_<Solver, Options...>& cls) {
  static_assert(std::is_base_of_v<SolverBase, Solver>);
  BoundClass<Solver>::remember(cls);
  static PyMethodDef definition = {
      "step", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&fast_step<Solver>)),
      METH_FASTCALL | METH_KEYWORDS,
      "step(self, state_in, state_out, control, contacts, dt)\n--\n\n"
      "Advances state_in by dt (s) into state_out. See SolverBase.step."};
  PyObject* method = PyDescr_NewMethod(reinterpret_cast<PyTypeObject*>(cls.ptr()), &definition);
  if (method == nullptr) throw py::error_already_set();
  cls.attr("step") = py::reinterpret_steal<py::object>(method);
}

}  // namespace novaphy::python
