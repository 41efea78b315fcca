// Bindings that are split from the file of their library into separate files.
#pragma once

#include <pybind11/pybind11.h>

namespace novaphy::python {

void bind_control_sensitivity(pybind11::module_& solvers);
void bind_engine_programs(pybind11::module_& diff);
void bind_nova_networks(pybind11::module_& nova);
void bind_push_box(pybind11::module_& diff);

}  // namespace novaphy::python
