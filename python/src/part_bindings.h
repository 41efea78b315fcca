// Functions that add bindings to a Python module. Each function is in a file of its own.
#pragma once

#include <pybind11/pybind11.h>

namespace novaphy::python {

void bind_control_sensitivity(pybind11::module_& solvers);
void bind_engine_programs(pybind11::module_& diff);
void bind_nova_networks(pybind11::module_& nova);
void bind_push_box(pybind11::module_& diff);

}  // namespace novaphy::python
