// The kernels of LaunchedContacts.
#pragma once

#include <iterator>
#include <utility>
#include <vector>

#include "articulation_contact_kernels.h"
#include "articulation_contact_vjp_kernels.h"
#include "novaphy/core/device_kernel.h"

namespace novaphy {
namespace detail {
const char* articulation_contact_kernels_text();
const char* articulation_contact_vjp_kernels_text();
}  // namespace detail

struct ContactKernels {
  DeviceKernel group{articulation_contact_group, detail::articulation_contact_kernels_text};
  DeviceKernel lists{"incidence_i32"};
  DeviceKernel step{articulation_contact_step, detail::articulation_contact_kernels_text};
  DeviceKernel keep{articulation_contact_keep, detail::articulation_contact_kernels_text};
  DeviceKernel copy{articulation_contact_copy, detail::articulation_contact_kernels_text};
  DeviceKernel note_some{articulation_note_some, detail::articulation_contact_kernels_text};
  DeviceKernel note_step{articulation_note_step, detail::articulation_contact_kernels_text};
  DeviceKernel vjp{articulation_contact_vjp, detail::articulation_contact_vjp_kernels_text};
  DeviceKernel clear{articulation_material_clear, detail::articulation_contact_vjp_kernels_text};
  DeviceKernel materials{articulation_material_gradient,
                         detail::articulation_contact_vjp_kernels_text};
};
// Never destroyed: recordings refer to them.
inline const ContactKernels& contact_kernels() {
  static const auto& all = *new ContactKernels;
  return all;
}

inline void add_words(std::vector<LaunchArgument>& to, std::vector<LaunchArgument> more) {
  to.insert(to.end(), std::make_move_iterator(more.begin()), std::make_move_iterator(more.end()));
}

}  // namespace novaphy
