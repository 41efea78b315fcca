// Error messages for arguments of a wrong type. pybind11's TypeError lists C++ signatures. This
// file replaces its message by one of novaphy._arguments, which names the argument.
//
// All functions of pybind11 share one C entry point, which each function's PyMethodDef points to.
// This file replaces the pointer by a wrapper that catches the TypeError. The wrapper costs an
// indirect jump per call, and the bindings need no further code.
#include <string>
#include <unordered_map>

#include "convert.h"

namespace novaphy::python {
namespace {

// The label of each function, such as "diff.Trajectory" or "Model.soft_contact_ke". The key is the
// object that pybind11 stores as `self` of the function.
std::unordered_map<PyObject*, std::string>& labels() {
  static auto* const names = new std::unordered_map<PyObject*, std::string>;  // outlives the module
  return *names;
}

struct Arguments {
  py::list positional;
  py::dict by_name;
};

// Replaces the current Python error if it is a TypeError about the arguments. The function must not
// throw a C++ exception, because C code of Python calls it.
template <class Given>
void explain(PyObject* function, const Given& given) {
  py::error_already_set error;
  try {
    const std::string message = py::str(error.value());
    if (message.find("(): incompatible ") == std::string::npos) return error.restore();
    const Arguments arguments = given();
    const py::object better =
        py::module_::import("novaphy._arguments")
            .attr("explain")(labels()[function], message, arguments.positional, arguments.by_name);
    PyErr_SetObject(PyExc_TypeError, better.ptr());
  } catch (py::error_already_set& failed) {
    failed.discard_as_unraisable("novaphy._arguments.explain");
    error.restore();
  } catch (const std::exception&) {
    error.restore();
  }
}

bool wrong_arguments(const PyObject* result) {
  return result == nullptr && PyErr_ExceptionMatches(PyExc_TypeError) != 0;
}

// pybind11's original entry point. Its calling convention depends on the version of pybind11.
using Vector = PyObject* (*)(PyObject*, PyObject* const*, Py_ssize_t, PyObject*);
Vector vector_entry = nullptr;
PyCFunctionWithKeywords tuple_entry = nullptr;

PyObject* call_vector(PyObject* self, PyObject* const* args, Py_ssize_t count, PyObject* names) {
  PyObject* const result = vector_entry(self, args, count, names);
  if (wrong_arguments(result)) [[unlikely]]
    explain(self, [&] {
      Arguments given;
      for (Py_ssize_t k = 0; k < count; ++k) given.positional.append(py::handle(args[k]));
      for (Py_ssize_t k = 0; names != nullptr && k < PyTuple_GET_SIZE(names); ++k)
        given.by_name[py::handle(PyTuple_GET_ITEM(names, k))] = py::handle(args[count + k]);
      return given;
    });
  return result;
}

PyObject* call_tuple(PyObject* self, PyObject* args, PyObject* keywords) {
  PyObject* const result = tuple_entry(self, args, keywords);
  if (wrong_arguments(result)) [[unlikely]]
    explain(self, [&] {
      return Arguments{
          py::list(py::reinterpret_borrow<py::tuple>(args)),
          keywords != nullptr ? py::reinterpret_borrow<py::dict>(keywords) : py::dict()};
    });
  return result;
}

template <class Function>
PyCFunction as_method(Function* function) {
  return reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(function));
}

void put_in_front(py::handle member, const std::string& label) {
  if (PyInstanceMethod_Check(member.ptr())) member = PyInstanceMethod_GET_FUNCTION(member.ptr());
  if (PyObject_TypeCheck(member.ptr(), &PyStaticMethod_Type))
    return put_in_front(member.attr("__func__"), label);
  if (PyObject_TypeCheck(member.ptr(), &PyProperty_Type)) {
    if (const py::object set = member.attr("fset"); !set.is_none()) put_in_front(set, label);
    return;
  }
  if (!PyCFunction_Check(member.ptr())) return;
  PyMethodDef& method = *reinterpret_cast<PyCFunctionObject*>(member.ptr())->m_ml;
  if (method.ml_flags == (METH_FASTCALL | METH_KEYWORDS)) {
    const auto entry = reinterpret_cast<Vector>(reinterpret_cast<void (*)()>(method.ml_meth));
    if (entry == &call_vector) return;  // the same function under two names
    vector_entry = entry;
    method.ml_meth = as_method(&call_vector);
  } else if (method.ml_flags == (METH_VARARGS | METH_KEYWORDS)) {
    const auto entry =
        reinterpret_cast<PyCFunctionWithKeywords>(reinterpret_cast<void (*)()>(method.ml_meth));
    if (entry == &call_tuple) return;
    tuple_entry = entry;
    method.ml_meth = as_method(&call_tuple);
  }
  labels()[PyCFunction_GET_SELF(member.ptr())] = label;
}

// Wraps all functions of a module or class. `prefix` is the start of their labels: "" for the
// module, "nova." for a submodule, "nova.Tensor." for a class.
void walk(py::handle owner, const std::string& prefix) {
  for (const auto& [key, value] : py::dict(owner.attr("__dict__").attr("copy")())) {
    const std::string name = py::str(key);
    if (PyModule_Check(value.ptr())) {
      walk(value, prefix + name + ".");
    } else if (PyType_Check(value.ptr())) {
      const std::string metaclass = py::str(py::type::of(value).attr("__name__"));
      if (metaclass == "pybind11_type") walk(value, prefix + name + ".");
    } else {
      const bool constructs = name == "__init__";
      put_in_front(value, constructs ? prefix.substr(0, prefix.size() - 1) : prefix + name);
    }
  }
}

}  // namespace

void explain_argument_errors(py::module_& m) { walk(m, ""); }

}  // namespace novaphy::python
