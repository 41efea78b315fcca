// Bindings of the traced values Real, Int and Bool, which functions for make_indexed_kernel use.
#include "convert.h"
#include "novaphy/nova/functions.h"

namespace novaphy::python {

using nova::Bool;
using nova::Int;
using nova::Real;

// A Python or NumPy number as an argument, which becomes a constant of a traced kernel. A bool is
// not accepted, so that it becomes a Bool.
struct RealConstant {
  float value = 0.0f;
};
struct IntConstant {
  int32_t value = 0;
};

}  // namespace novaphy::python

namespace pybind11::detail {

template <>
struct type_caster<novaphy::python::RealConstant> {
  PYBIND11_TYPE_CASTER(novaphy::python::RealConstant, const_name("float"));
  bool load(handle source, bool) {
    PyObject* p = source.ptr();
    const PyNumberMethods* number = Py_TYPE(p)->tp_as_number;
    const bool ok = PyFloat_Check(p) || (PyLong_Check(p) && !PyBool_Check(p)) ||
                    (number != nullptr && number->nb_float != nullptr && !PySequence_Check(p) &&
                     !PyBool_Check(p));
    if (!ok) return false;
    const double v = PyFloat_AsDouble(p);
    if (v == -1.0 && PyErr_Occurred()) {
      PyErr_Clear();
      return false;
    }
    value.value = static_cast<float>(v);
    return true;
  }
};

template <>
struct type_caster<novaphy::python::IntConstant> {
  PYBIND11_TYPE_CASTER(novaphy::python::IntConstant, const_name("int"));
  bool load(handle source, bool) {
    if (PyBool_Check(source.ptr()) || !PyIndex_Check(source.ptr()) ||
        PySequence_Check(source.ptr()))
      return false;
    value.value = novaphy::python::to_int32(source, "constant");
    return true;
  }
};

}  // namespace pybind11::detail

namespace novaphy::python {
namespace {

[[noreturn]] void no_truth_value(const char* type) {
  throw py::type_error(std::string("a traced ") + type +
                       " has no truth value while a kernel is traced: write nova.select(condition, "
                       "a, b) instead of an "
                       "if, and &, | and ~ instead of and, or and not");
}

#define NOVAPHY_TRACED(cls, name, T, expression) \
  cls.def(                                       \
      "__" name "__", [](const T& a, const T& b) { return expression; }, py::is_operator())
// Binds an operator and its reflected form (__radd__, ...), so that either operand may be a number.
#define NOVAPHY_TRACED_PAIR(cls, name, T, expression) \
  NOVAPHY_TRACED(cls, name, T, expression);           \
  cls.def(                                            \
      "__r" name "__", [](const T& b, const T& a) { return expression; }, py::is_operator())

// Returns x^n for an integer n by repeated squaring, which is cheaper than pow, and exact for n =
// 2.
Real whole_power(const Real& x, int32_t n) {
  if (n < -16 || n > 16) return nova::pow(x, Real(static_cast<float>(n)));
  Real result(1.0f), square = x;
  for (int32_t bits = n < 0 ? -n : n; bits != 0; bits >>= 1) {
    if (bits & 1) result = result * square;
    if (bits > 1) square = square * square;
  }
  return n < 0 ? Real(1.0f) / result : result;
}

void bind_real(py::module_& m) {
  py::class_<Real> c(m, "Real", "A float32 value in a traced function.");
  c.def(py::init([](const RealConstant& v) { return Real(v.value); }), "value"_a,
        "Makes a constant.");
  py::implicitly_convertible<RealConstant, Real>();
  NOVAPHY_TRACED_PAIR(c, "add", Real, a + b);
  NOVAPHY_TRACED_PAIR(c, "sub", Real, a - b);
  NOVAPHY_TRACED_PAIR(c, "mul", Real, a * b);
  NOVAPHY_TRACED_PAIR(c, "truediv", Real, a / b);
  c.def(
      "__pow__", [](const Real& a, const IntConstant& n) { return whole_power(a, n.value); },
      py::is_operator());
  NOVAPHY_TRACED_PAIR(c, "pow", Real, nova::pow(a, b));
  NOVAPHY_TRACED(c, "lt", Real, a < b);
  NOVAPHY_TRACED(c, "le", Real, a <= b);
  NOVAPHY_TRACED(c, "gt", Real, a > b);
  NOVAPHY_TRACED(c, "ge", Real, a >= b);
  NOVAPHY_TRACED(c, "eq", Real, a == b);
  NOVAPHY_TRACED(c, "ne", Real, a != b);
  c.def("__neg__", [](const Real& a) { return -a; })
      .def("__pos__", [](const Real& a) { return a; })
      .def("__abs__", [](const Real& a) { return nova::abs(a); })
      .def("__bool__", [](const Real&) -> bool { no_truth_value("Real"); });
  c.attr("__array_ufunc__") = py::none();
  c.attr("__hash__") = py::none();
}

void bind_int(py::module_& m) {
  py::class_<Int> c(m, "Int", "An int32 value in a traced function. Arithmetic wraps around.");
  c.def(py::init([](const IntConstant& v) { return Int(v.value); }), "value"_a,
        "Makes a constant.");
  py::implicitly_convertible<IntConstant, Int>();
  NOVAPHY_TRACED_PAIR(c, "add", Int, a + b);
  NOVAPHY_TRACED_PAIR(c, "sub", Int, a - b);
  NOVAPHY_TRACED_PAIR(c, "mul", Int, a * b);
  NOVAPHY_TRACED_PAIR(c, "and", Int, a & b);
  NOVAPHY_TRACED_PAIR(c, "or", Int, a | b);
  NOVAPHY_TRACED_PAIR(c, "xor", Int, a ^ b);
  NOVAPHY_TRACED_PAIR(c, "lshift", Int, a << b);
  NOVAPHY_TRACED_PAIR(c, "rshift", Int, a >> b);
  NOVAPHY_TRACED(c, "lt", Int, a < b);
  NOVAPHY_TRACED(c, "le", Int, a <= b);
  NOVAPHY_TRACED(c, "gt", Int, a > b);
  NOVAPHY_TRACED(c, "ge", Int, a >= b);
  NOVAPHY_TRACED(c, "eq", Int, a == b);
  NOVAPHY_TRACED(c, "ne", Int, a != b);
  c.def("__neg__", [](const Int& a) { return Int(0) - a; }).def("__bool__", [](const Int&) -> bool {
    no_truth_value("Int");
  });
  c.attr("__array_ufunc__") = py::none();
  c.attr("__hash__") = py::none();
  m.def(
      "idiv", [](const Int& a, const Int& b) { return a / b; }, "a"_a, "b"_a,
      "Returns the quotient, truncated as in C; 0 for a zero divisor.");
  m.def(
      "imod", [](const Int& a, const Int& b) { return a % b; }, "a"_a, "b"_a,
      "Returns the remainder with the sign of a, as in C; 0 for a zero divisor.");
}

void bind_bool(py::module_& m) {
  py::class_<Bool> c(
      m, "Bool", "A truth value in a traced function. bool() is not supported: use nova.select.");
  c.def(py::init<bool>(), "value"_a, "Makes a constant.")
      .def(
          "__and__", [](const Bool& a, const Bool& b) { return both(a, b); }, py::is_operator())
      .def(
          "__or__", [](const Bool& a, const Bool& b) { return either(a, b); }, py::is_operator())
      .def("__invert__", [](const Bool& a) { return negate(a); })
      .def("__bool__", [](const Bool&) -> bool { no_truth_value("Bool"); });
  c.attr("__hash__") = py::none();
}

#define NOVAPHY_REAL_UNARY(name, doc) \
  m.def(                              \
      #name, [](const Real& x) { return nova::name(x); }, "x"_a, doc);

// Binds functions of traced values. For functions that also exist for tensors, these are overloads.
void bind_traced_functions(py::module_& m) {
  NOVAPHY_REAL_UNARY(abs, "")
  NOVAPHY_REAL_UNARY(sqrt, "")
  NOVAPHY_REAL_UNARY(exp, "")
  NOVAPHY_REAL_UNARY(log, "")
  NOVAPHY_REAL_UNARY(sin, "")
  NOVAPHY_REAL_UNARY(cos, "")
  NOVAPHY_REAL_UNARY(tanh, "")
  NOVAPHY_REAL_UNARY(tan, "Returns the tangent of x (rad).")
  NOVAPHY_REAL_UNARY(asin, "Returns the arc sine (rad).")
  NOVAPHY_REAL_UNARY(acos, "Returns the arc cosine (rad).")
  NOVAPHY_REAL_UNARY(rsqrt, "Returns 1 / sqrt(x).")
  NOVAPHY_REAL_UNARY(floor, "Returns the largest integer <= x, as a Real.")
  NOVAPHY_REAL_UNARY(sign, "Returns -1 for x < 0, else +1.")
  NOVAPHY_REAL_UNARY(to_int, "Truncates x to an Int. Large values saturate, NaN gives 0.")
  NOVAPHY_REAL_UNARY(detach, "Returns x as a constant for derivatives.")
  m.def(
      "step", [](const Real& x) { return novaphy::math::step(x); }, "x"_a, "1 if x < 0, else 0.");
  m.def(
      "to_real", [](const Int& x) { return nova::to_real(x); }, "x"_a, "The nearest float32.");
  m.def(
      "atan2", [](const Real& y, const Real& x) { return nova::atan2(y, x); }, "y"_a, "x"_a,
      "Returns the angle of the point (x, y) (rad).");
  m.def(
      "pow", [](const Real& x, const Real& y) { return nova::pow(x, y); }, "x"_a, "y"_a,
      "Returns x to the power of y.");
  m.def(
      "fma", [](const Real& a, const Real& b, const Real& c) { return nova::fma(a, b, c); }, "a"_a,
      "b"_a, "c"_a, "Returns a * b + c, rounded once.");
  m.def(
      "clamp",
      [](const Real& x, const Real& lo, const Real& hi) { return novaphy::math::clamp(x, lo, hi); },
      "x"_a, "lower"_a, "upper"_a);
  for (const char* name : {"min", "minimum"}) {
    m.def(
        name, [](const Real& a, const Real& b) { return nova::min(a, b); }, "a"_a, "b"_a,
        "Returns a if a <= b, else b. The gradient goes to a if a < b, else to b.");
    m.def(
        name, [](const Int& a, const Int& b) { return nova::min(a, b); }, "a"_a, "b"_a);
  }
  for (const char* name : {"max", "maximum"}) {
    m.def(
        name, [](const Real& a, const Real& b) { return nova::max(a, b); }, "a"_a, "b"_a,
        "Returns a if a >= b, else b. The gradient goes to a if a > b, else to b.");
    m.def(
        name, [](const Int& a, const Int& b) { return nova::max(a, b); }, "a"_a, "b"_a);
  }
  // The overload for Real comes first, so that select(c, 1, 0) with two numbers gives a Real.
  m.def(
      "select", [](const Bool& c, const Real& a, const Real& b) { return nova::select(c, a, b); },
      "condition"_a, "a"_a, "b"_a,
      "Returns a if the condition is true, else b. The gradient is that of the selected value.");
  m.def(
      "select", [](const Bool& c, const Int& a, const Int& b) { return nova::select(c, a, b); },
      "condition"_a, "a"_a, "b"_a);
  m.def(
      "select", [](const Bool& c, const Bool& a, const Bool& b) { return nova::select(c, a, b); },
      "condition"_a, "a"_a, "b"_a);
  m.def(
      "with_derivative",
      [](const Real& y, const Real& x, const Real& dy_dx) {
        return nova::with_derivative(y, x, dy_dx);
      },
      "y"_a, "x"_a, "dy_dx"_a,
      "Returns y with the additional derivative dy_dx with respect to x. If dy_dx is the whole "
      "derivative, pass detach(y) for y.");
}

}  // namespace

void bind_nova_trace(py::module_& m) {
  bind_real(m);
  bind_int(m);
  bind_bool(m);
  bind_traced_functions(m);
}

}  // namespace novaphy::python
