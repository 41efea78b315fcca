// The kernels that ContactSteps launches.
#pragma once

#include "articulation_contact_kernels.h"
#include "articulation_contact_vjp_kernels.h"
#include "articulation_step.h"
#include "novaphy/core/builtin_kernels.h"

namespace novaphy {
namespace detail {
const char* articulation_contact_kernels_source();
const char* articulation_contact_vjp_kernels_source();
}  // namespace detail

struct ContactKernels {
#define NOVAPHY_CONTACT_KERNEL(name) \
  Kernel<decltype(articulation_##name)::Arguments> name{articulation_##name, source};
#define NOVAPHY_STEP_KERNEL(name) \
  Kernel<ArticulationContactStepArguments> name{kInChunks<articulation_##name, kTreeRows>, source};
  static constexpr DeviceSource source = detail::articulation_contact_kernels_source,
                                vjp_text = detail::articulation_contact_vjp_kernels_source;
  NOVAPHY_CONTACT_KERNEL(contact_group)
  Kernel<ArticulationContactStepArguments> contact_step{
      kInChunks<articulation_contact_step, kTreeRows * kTeamThreads>, source};
  NOVAPHY_STEP_KERNEL(contact_open)
  NOVAPHY_STEP_KERNEL(contact_islands)
  NOVAPHY_STEP_KERNEL(contact_start)
  NOVAPHY_STEP_KERNEL(contact_solve)
  NOVAPHY_STEP_KERNEL(contact_finish)
  NOVAPHY_STEP_KERNEL(contact_notes)
  NOVAPHY_CONTACT_KERNEL(contact_keep)
  NOVAPHY_CONTACT_KERNEL(contact_copy)
  NOVAPHY_CONTACT_KERNEL(note_some)
  NOVAPHY_CONTACT_KERNEL(note_step)
#undef NOVAPHY_CONTACT_KERNEL
#undef NOVAPHY_STEP_KERNEL
  Kernel<ArticulationContactVjpArguments> vjp{kInChunks<articulation_contact_vjp, kTreeRows>,
                                              vjp_text};
  Kernel<ArticulationMaterialClearArguments> clear{articulation_material_clear, vjp_text};
  Kernel<ArticulationMaterialGradientArguments> materials{articulation_material_gradient, vjp_text};
};
// The object is never destroyed, because recordings refer to the kernels.
inline const ContactKernels& contact_kernels() {
  static const auto& all = *new ContactKernels;
  return all;
}

}  // namespace novaphy
