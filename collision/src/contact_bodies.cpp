#include "novaphy/collision/contact_bodies.h"

#include "contact_bodies.h"
#include "contact_body_kernels.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {

void find_contact_bodies(const Model& model, const Contacts& contacts,
                         const DeviceArray<int32_t>& rigid, const DeviceArray<int32_t>& soft) {
  // Never destroyed, because recordings refer to the kernel.
  static const auto& kernel =
      *new Kernel<ContactBodyArguments>(contact_body, detail::contact_body_kernels_source);
  const auto find = [&](const DeviceArray<int32_t>& shape0, const DeviceArray<int32_t>* shape1,
                        const DeviceArray<int32_t>& bodies) {
    run(kernel, static_cast<int64_t>(bodies.rows()),
        {.shape0 = shape0,
         .shape1 = shape1,
         .shape_body = model.shape_body,
         .shapes = model.shape_count(),
         .bodies = bodies});
  };
  find(contacts.rigid_contact_shape0, &contacts.rigid_contact_shape1, rigid);
  find(contacts.soft_contact_shape, nullptr, soft);
}

bool particles_may_meet_bodies(const Model& model) {
  if (model.particle_count() == 0 || model.body_count() == 0) return false;
  const std::vector<int32_t> body = model.shape_body.to_host(), flags = model.shape_flags.to_host();
  for (size_t s = 0; s < body.size(); ++s)
    if (body[s] >= 0 && has_flag(flags[s], ShapeFlags::COLLIDE_PARTICLES)) return true;
  return false;
}

}  // namespace novaphy
