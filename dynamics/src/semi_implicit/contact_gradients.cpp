#include "novaphy/dynamics/semi_implicit/contact_gradients.h"

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/semi_implicit/contact_moves_kernels.h"

namespace novaphy {

static_assert(moving_contact_detail::kFacePreference == geometry::kFacePreference);

std::vector<bool> exact_contact_gradients(const Model& model, const SimState& state,
                                          const Contacts& contacts) {
  constexpr const char* name = "exact_contact_gradients";
  require(state.model_id() == model.id(), ErrorKind::Value, name,
          ": state: expected a state of the model, got one of another");
  require(contacts.model_id() == model.id(), ErrorKind::Value, name,
          ": contacts: expected contacts of the model, got those of another");
  const OnHost count(contacts.rigid_contact_count), shape0(contacts.rigid_contact_shape0),
      shape1(contacts.rigid_contact_shape1), shape_body(model.shape_body),
      shape_type(model.shape_type);
  const OnHost point0(contacts.rigid_contact_point0), point1(contacts.rigid_contact_point1),
      normal(contacts.rigid_contact_normal), shape_scale(model.shape_scale);
  const OnHost body_q(state.body_q), shape_transform(model.shape_transform);
  const int32_t rows = filled_rows(count[0], contacts.rigid_contact_max(), shape0.data());
  const bool follow = contacts.rigid_contacts_found_from(model, state.body_q);
  const MovingContacts of = {.shape0 = direct(shape0.data()),
                               .shape1 = direct(shape1.data()),
                               .point0 = direct(point0.data()),
                               .point1 = direct(point1.data()),
                               .normal = direct(normal.data()),
                               .body_q = direct(body_q.data()),
                               .shape_body = direct(shape_body.data()),
                               .shape_type = direct(shape_type.data()),
                               .shape_transform = direct(shape_transform.data()),
                               .shape_scale = direct(shape_scale.data())};
  std::vector<bool> exact(static_cast<size_t>(rows));
  for (int32_t row = 0; row < rows; ++row) {
    const auto r = static_cast<size_t>(row);
    for (const int32_t s : {shape0[r], shape1[r]})
      require(s >= 0 && s < model.shape_count(), ErrorKind::Index, name,
              ": contacts: rigid_contact_shape0, shape1[", row, "]: expected 0 to ",
              model.shape_count() - 1, ", got ", s);
    exact[r] = follow && contact_moves(of, row);
  }
  return exact;
}

bool is_exact_while_frozen(const Model& m, int32_t shape) {
  const auto s = static_cast<size_t>(shape);
  return is_endless_plane(m.shape_type.data()[s], m.shape_scale.data()[s]);
}

bool has_exact_gradient(const Model& m, const DeviceArray<Transformf>& body_q,
                        const ContactFields& c, int32_t row) {
  const MovingContacts of = {.shape0 = direct(c.rigid_contact_shape0.data()),
                               .shape1 = direct(c.rigid_contact_shape1.data()),
                               .point0 = direct(c.rigid_contact_point0.data()),
                               .point1 = direct(c.rigid_contact_point1.data()),
                               .normal = direct(c.rigid_contact_normal.data()),
                               .body_q = direct(body_q.data()),
                               .shape_body = direct(m.shape_body.data()),
                               .shape_type = direct(m.shape_type.data()),
                               .shape_transform = direct(m.shape_transform.data()),
                               .shape_scale = direct(m.shape_scale.data())};
  return contact_moves(of, row);
}

}  // namespace novaphy
