// GradientInfo in Python: the fields that all solvers have, and those of one.
#pragma once

#include <pybind11/pybind11.h>

#include "novaphy/dynamics/gradient_info.h"

namespace novaphy::python {

// Each field is an attribute and a key.
struct GradientInfoFields {
  pybind11::dict fields;
};
// `more`: what this solver tells besides; it may not have the names of the others.
GradientInfoFields to_fields(const GradientInfo& info, const pybind11::dict& more = {});

// "code" or "motion". ErrorKind::Value: another one.
diff::DerivativeOf to_contact_gradient(const char* user, const std::string& name);
const char* contact_gradient_name(diff::DerivativeOf of);

void bind_gradient_info(pybind11::module_& solvers);

}  // namespace novaphy::python
