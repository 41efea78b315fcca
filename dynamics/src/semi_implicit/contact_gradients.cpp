#include "novaphy/dynamics/semi_implicit/contact_gradients.h"

#include <algorithm>

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/semi_implicit/contact_follows_kernels.h"

namespace novaphy {

static_assert(contact_turning_detail::kFacePreference == geometry::kFacePreference);

std::vector<bool> exact_contact_gradients(const Model& model, const SimState& state,
                                          const Contacts& contacts) {
  constexpr const char* name = "exact_contact_gradients";
  require(state.model_id() == model.id(), ErrorKind::Value, name,
          ": state: expected a state of the model, got one of another");
  require(contacts.model_id() == model.id(), ErrorKind::Value, name,
          ": contacts: expected contacts of the model, got those of another");
  require(model.device().is_cpu(), ErrorKind::NotImplemented, name,
          ": model: expected one on the cpu, got one on ", model.device().str());
  const int32_t rows =
      std::clamp(contacts.rigid_contact_count.data()[0], 0, contacts.rigid_contact_max());
  const bool follow = contacts.rigid_contacts_found_from(model, state.body_q);
  const FollowedContacts of = {contacts.rigid_contact_shape0.data(),
                               contacts.rigid_contact_shape1.data(),
                               contacts.rigid_contact_point0.data(),
                               contacts.rigid_contact_point1.data(),
                               contacts.rigid_contact_normal.data(),
                               state.body_q.data(),
                               model.shape_body.data(),
                               model.shape_type.data(),
                               model.shape_transform.data(),
                               model.shape_scale.data()};
  std::vector<bool> exact(static_cast<size_t>(rows));
  for (int32_t row = 0; row < rows; ++row) {
    const int32_t shape[2] = {contacts.rigid_contact_shape0.data()[row],
                              contacts.rigid_contact_shape1.data()[row]};
    for (const int32_t s : shape)
      require(s >= 0 && s < model.shape_count(), ErrorKind::Index, name,
              ": contacts: rigid_contact_shape0, shape1[", row, "]: expected 0 to ",
              model.shape_count() - 1, ", got ", s);
    if (!follow) continue;
    exact[static_cast<size_t>(row)] = contact_follows(of, row);
  }
  return exact;
}

}  // namespace novaphy
