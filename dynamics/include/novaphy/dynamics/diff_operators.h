// The list of all operator kernels of this library whose adjoints are compiled ahead of time. See
// <novaphy/nova/registry.h>.
#pragma once

#include <vector>

#include "novaphy/dynamics/export.h"
#include "novaphy/nova/registry.h"

namespace novaphy::diff {

NOVAPHY_DYNAMICS_API std::vector<nova::EngineKernel> operator_kernels();

namespace detail {
// Each function adds the kernels of the file that is named on the right.
void add_body_contact_kernels(std::vector<nova::EngineKernel>& list);  // diff_body_contacts.cpp
void add_contact_kernels(std::vector<nova::EngineKernel>& list);       // diff_soft_contacts.cpp
void add_element_kernels(std::vector<nova::EngineKernel>& list);       // diff_elements.cpp
void add_tet_material_kernels(std::vector<nova::EngineKernel>& list);  // diff_tetrahedra.cpp
void add_particle_kernels(std::vector<nova::EngineKernel>& list);      // diff_particles.cpp
void add_rigid_kernels(std::vector<nova::EngineKernel>& list);         // diff_rigid_bodies.cpp
void add_derived_kernels(std::vector<nova::EngineKernel>& list);       // diff_model_reads.cpp
void add_solver_kernels(std::vector<nova::EngineKernel>& list);        // diff_solver_base.cpp
}  // namespace detail

}  // namespace novaphy::diff
