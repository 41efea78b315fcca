// Arguments of ModelBuilder's functions that add elements, grids and meshes, converted from Python.
#pragma once

#include <optional>
#include <vector>

#include "convert.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy::python {

using OptionalFloat = std::optional<float>;

// Returns indices as a flat list. The value is a flat list, or has rows of `width` indices.
inline std::vector<int32_t> flat_indices(py::handle value, const char* name, int64_t width) {
  py::object array = numpy().asarray(value);
  if (array.attr("size").cast<int64_t>() == 0) return {};
  const auto shape = array.attr("shape").cast<std::vector<int64_t>>();
  require(shape.size() == 1 || (shape.size() == 2 && shape[1] == width), ErrorKind::Value, name,
          ": expected shape (n,) or (n, ", width, "), got ",
          std::string(py::str(array.attr("shape"))));
  return to_int_list(array.attr("reshape")(-1), name);
}

// Returns the values of a list, a single value for a number, and an empty list for None.
inline std::vector<float> one_or_each(py::handle value, const char* name) {
  if (value.is_none()) return {};
  if (PyFloat_Check(value.ptr()) || PyLong_Check(value.ptr())) return {to_float(value, name)};
  if (PyObject_HasAttrString(value.ptr(), "__array_interface__") != 0 &&
      value.attr("ndim").cast<int>() == 0)
    return {to_float(value, name)};
  return to_float_list(value, name);
}

inline Placement placement(py::handle pos, py::handle rot, py::handle vel) {
  const Vec4f q = to_vec4(rot, "rot");
  return {to_vec3(pos, "pos"), {q.x, q.y, q.z, q.w}, to_vec3(vel, "vel")};
}

// Returns the argument. If the argument is None, returns the attribute of the mesh.
inline py::object given_or(const py::object& mesh, const char* attribute,
                           const py::object& argument) {
  if (!argument.is_none() || mesh.is_none()) return argument;
  return py::getattr(mesh, attribute, py::none());
}

// The lists of TetMaterials.
class TetMaterialLists {
 public:
  TetMaterialLists(py::handle mu, py::handle lambda, py::handle damp, py::handle young,
                   py::handle ratio)
      : mu_(one_or_each(mu, "k_mu")),
        lambda_(one_or_each(lambda, "k_lambda")),
        damp_(one_or_each(damp, "k_damp")),
        young_(one_or_each(young, "youngs_modulus")),
        ratio_(one_or_each(ratio, "poisson_ratio")) {}
  TetMaterials view() const { return {mu_, lambda_, damp_, young_, ratio_}; }

 private:
  std::vector<float> mu_, lambda_, damp_, young_, ratio_;
};

void bind_soft_bodies(py::class_<ModelBuilder>& builder);

}  // namespace novaphy::python
