// The ahead-of-time code of a plugin that was built with NOVA_ENABLE_NVRTC=OFF: the builtins, the
// interpreter and the handwritten kernels. The code is empty here, because the fake driver finds
// kernels by name.
#include <algorithm>
#include <cstring>
#include <iterator>
#include <vector>

#include "ahead.h"
#include "device_source.h"

namespace novaphy::detail {
const char* soft_contact_kernels_source();
const char* rigid_contact_kernels_source();
const char* rigid_mesh_kernels_source();
const char* rigid_tree_kernels_source();
const char* contact_body_kernels_source();
const char* articulation_contact_kernels_source();
const char* articulation_contact_jvp_kernels_source();
const char* articulation_contact_vjp_kernels_source();
const char* articulation_functions_kernels_source();
const char* articulation_jvp_kernels_source();
const char* articulation_kernels_source();
const char* body_actuation_kernels_source();
const char* gradient_notes_kernels_source();
const char* joint_coordinates_kernels_source();
#ifdef FAKE_DRIVER_HAS_VBD
const char* vbd_kernels_source();
const char* vbd_adjoint_kernels_source();
const char* vbd_coarse_kernels_source();
const char* vbd_gradient_kernels_source();
const char* vbd_tangent_kernels_source();
#endif
}  // namespace novaphy::detail

namespace novaphy::gpu {

AheadData ahead_data() {
  static const std::vector<unsigned char> bytes = [] {
    constexpr const char* (*kHandWritten[])() = {
        detail::soft_contact_kernels_source,
        detail::rigid_contact_kernels_source,
        detail::rigid_mesh_kernels_source,
        detail::rigid_tree_kernels_source,
        detail::contact_body_kernels_source,
        detail::articulation_contact_kernels_source,
        detail::articulation_contact_jvp_kernels_source,
        detail::articulation_contact_vjp_kernels_source,
        detail::articulation_functions_kernels_source,
        detail::articulation_jvp_kernels_source,
        detail::articulation_kernels_source,
        detail::body_actuation_kernels_source,
        detail::gradient_notes_kernels_source,
        detail::joint_coordinates_kernels_source,
#ifdef FAKE_DRIVER_HAS_VBD
        detail::vbd_kernels_source,
        detail::vbd_adjoint_kernels_source,
        detail::vbd_coarse_kernels_source,
        detail::vbd_gradient_kernels_source,
        detail::vbd_tangent_kernels_source,
#endif
    };
    AheadEntry entries[2 + std::size(kHandWritten)];
    entries[0].key = ahead_key(builtins_source(), Dialect::Program);
    entries[1].key = ahead_key(interpreter_source(), Dialect::Program);
    for (size_t k = 0; k < std::size(kHandWritten); ++k)
      entries[2 + k].key = ahead_key(module_source(kHandWritten[k]()), Dialect::Source);
    std::sort(std::begin(entries), std::end(entries),
              [](const AheadEntry& x, const AheadEntry& y) { return x.key.a < y.key.a; });
    AheadHeader header{};
    std::memcpy(header.magic, kAheadMagic, sizeof(header.magic));
    header.count = std::size(entries);
    std::vector<unsigned char> all(sizeof(header) + sizeof(entries) + 1);
    for (AheadEntry& entry : entries) {
      entry.arch = 90;
      entry.offset = sizeof(header) + sizeof(entries);
      entry.bytes = 1;
    }
    std::memcpy(all.data(), &header, sizeof(header));
    std::memcpy(all.data() + sizeof(header), entries, sizeof(entries));
    return all;
  }();
  return {bytes.data(), bytes.size()};
}

}  // namespace novaphy::gpu
