#include "novaphy/dynamics/semi_implicit/contact_gradients.h"

#include <algorithm>

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/semi_implicit/contact_turning_trace.h"

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
  const int32_t *const body = model.shape_body.data(), *const type = model.shape_type.data();
  const auto pose_of = [&](int32_t shape) {
    return body[shape] < 0 ? Transformf::identity() : state.body_q.data()[body[shape]];
  };
  const auto shape_of = [&](int32_t shape) {
    const auto is = [&](GeoType wanted) { return type[shape] == static_cast<int32_t>(wanted); };
    return ContactShape<bool, float>{is(GeoType::PLANE),
                                     is(GeoType::SPHERE),
                                     is(GeoType::CAPSULE),
                                     is(GeoType::BOX),
                                     is(GeoType::ELLIPSOID),
                                     is(GeoType::CYLINDER),
                                     is(GeoType::CONE),
                                     is(GeoType::CONVEX_MESH) || is(GeoType::MESH),
                                     model.shape_transform.data()[shape],
                                     model.shape_scale.data()[shape]};
  };
  const bool follow = contacts.rigid_contacts_found_from(model, state.body_q);
  std::vector<bool> exact(static_cast<size_t>(rows));
  for (int32_t row = 0; row < rows; ++row) {
    const int32_t shape[2] = {contacts.rigid_contact_shape0.data()[row],
                              contacts.rigid_contact_shape1.data()[row]};
    for (const int32_t s : shape)
      require(s >= 0 && s < model.shape_count(), ErrorKind::Index, name,
              ": contacts: rigid_contact_shape0, shape1[", row, "]: expected 0 to ",
              model.shape_count() - 1, ", got ", s);
    if (!follow) continue;
    const Vec3f point[2] = {contacts.rigid_contact_point0.data()[row],
                            contacts.rigid_contact_point1.data()[row]};
    const Transformf pose[2] = {pose_of(shape[0]), pose_of(shape[1])};
    const Vec3f world[2] = {math::transform_point(pose[0], point[0]),
                            math::transform_point(pose[1], point[1])};
    const Vec3f normal = contacts.rigid_contact_normal.data()[row];
    exact[static_cast<size_t>(row)] =
        turning_contact(contact_feature_of(shape_of(shape[0]), pose[0], point[0], world[1], normal),
                        contact_feature_of(shape_of(shape[1]), pose[1], point[1], world[0], normal),
                        normal)
            .is_exact;
  }
  return exact;
}

}  // namespace novaphy
