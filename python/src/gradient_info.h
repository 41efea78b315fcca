// GradientInfo in Python: the fields that all solvers have, and additional fields of one solver.
#pragma once

#include <pybind11/pybind11.h>

#include "novaphy/dynamics/gradient_info.h"

namespace novaphy::python {

// The Python object GradientInfo, in which each field is an attribute and a key.
struct GradientInfoFields {
  pybind11::dict fields;
};
// Returns the Python object. `more` has additional fields of one solver, with other names.
GradientInfoFields to_fields(const GradientInfo& info, const pybind11::dict& more = {});

// Reads "auto", "code" or "motion". ErrorKind::Value: another name.
diff::DerivativeOf to_contact_gradient(const char* user, const std::string& name);
const char* contact_gradient_name(diff::DerivativeOf of);

void bind_gradient_info(pybind11::module_& solvers);

}  // namespace novaphy::python
