// The kernels that GradientNotes launches.
#pragma once

#include "gradient_notes_kernels.h"
#include "novaphy/core/device_kernel.h"

namespace novaphy {
namespace detail {
const char* gradient_notes_kernels_source();
}

struct NoteKernels {
  Kernel<NoteSoftContactsArguments> soft{note_soft_contacts, detail::gradient_notes_kernels_source};
  Kernel<NoteRigidContactsArguments> rigid{note_rigid_contacts,
                                           detail::gradient_notes_kernels_source};
  Kernel<NoteStaticParticlesArguments> static_particles{note_static_particles,
                                                        detail::gradient_notes_kernels_source};
  Kernel<NotePlanePairsArguments> planes{note_plane_pairs, detail::gradient_notes_kernels_source};
  Kernel<NoteContactEventsArguments> events{note_contact_events,
                                            detail::gradient_notes_kernels_source};
  Kernel<NoteGradientStepArguments> step{note_gradient_step, detail::gradient_notes_kernels_source};
};
// The object is never destroyed, because recordings refer to the kernels.
inline const NoteKernels& note_kernels() {
  static const auto& all = *new NoteKernels;
  return all;
}

}  // namespace novaphy
