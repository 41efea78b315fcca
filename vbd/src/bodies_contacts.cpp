// The contacts of a step of bodies, and their multipliers, which the next step starts from.
#include <algorithm>
#include <tuple>

#include "bodies_side.h"
#include "novaphy/core/error.h"

namespace novaphy::vbd {
namespace {

constexpr float kRise = 0.5f;             // m/s, speed at which the ignored depth shrinks
constexpr float kLeastCosine = 0.70711f;  // between normals of a contact in successive steps

size_t at(int32_t k) { return static_cast<size_t>(k); }

std::tuple<int32_t, int32_t, int32_t> key_of(const ContactMemory& m) {
  return {m.shape[0], m.shape[1], m.point};
}

}  // namespace

bool is_world_plane(const Model& m, int32_t shape) {
  const auto s = at(shape);
  const Vec3f& size = m.shape_scale.data()[s];
  return m.shape_body.data()[s] < 0 && !(size.x > 0.0f && size.y > 0.0f) &&
         m.shape_type.data()[s] == static_cast<int32_t>(GeoType::PLANE);
}

void Bodies::put_contacts(const SimState& in, const Contacts& contacts) {
  const auto* const memory = memory_at<ContactMemory>(contacts_at());
  recalled_.clear();
  for (size_t k = 0; k < contact_rows_ && memory[k].is_used != 0.0f; ++k)
    recalled_.push_back(static_cast<int32_t>(k));
  std::sort(recalled_.begin(), recalled_.end(), [memory](int32_t a, int32_t b) {
    return std::pair(key_of(memory[a]), a) < std::pair(key_of(memory[b]), b);
  });
  const auto count = at(*contacts.rigid_contact_count.data());
  for (size_t slot = 0; slot < count; ++slot) put_contact(in, contacts, slot);
  // Contacts that push at the initial guess come first, so that the trees use them as edges.
  for (const bool pushes : {true, false}) {
    for (size_t k = 0; k < contact_.size(); ++k) {
      const VbdBodyContact& c = contact_[k];
      const auto moving = [&](int side) {
        return c.body[side] < 0 || is_kinematic_.data()[c.body[side]] != 0 ? -1 : c.body[side];
      };
      const float depth = contact_depth(c, motion_of(motion_.data(), c.body[0]),
                                        motion_of(motion_.data(), c.body[1]));
      if ((depth > 0.0f || c.lam_n > 0.0f) != pushes) continue;
      pairs_.push_back({moving(0), moving(1)});
      numbers_.push_back(8 * static_cast<int32_t>(k) + 2 * kContactRow);
    }
    if (pushes) acting_ = pairs_.size();
  }
}

void Bodies::put_contact(const SimState& in, const Contacts& contacts, size_t slot) {
  const Model& m = model_;
  const int32_t shapes[2] = {contacts.rigid_contact_shape0.data()[slot],
                             contacts.rigid_contact_shape1.data()[slot]};
  VbdBodyContact c;
  for (int k = 0; k < 2; ++k) {
    require(shapes[k] >= 0 && shapes[k] < m.shape_count(), ErrorKind::Index,
            "SolverVBD.step: contacts.rigid_contact_shape", k, "[", slot, "]: expected 0 to ",
            m.shape_count() - 1, ", got ", shapes[k]);
    c.body[k] = m.shape_body.data()[shapes[k]];
  }
  const BodySide sides[2] = {{m, in, is_kinematic_.data(), c.body[0]},
                             {m, in, is_kinematic_.data(), c.body[1]}};
  const auto of_pair = [&](const DeviceArray<float>& of_rows, const DeviceArray<float>& of_shapes,
                           bool& has_own) {
    const float own = of_rows.rows() == 0 ? 0.0f : of_rows.data()[slot];
    const float mean = 0.5f * (of_shapes.data()[shapes[0]] + of_shapes.data()[shapes[1]]);
    has_own = own > 0.0f;
    return has_own ? own : mean;
  };
  ContactOrigin origin = {.start = {}, .shape = {shapes[0], shapes[1]}};
  ContactStart<float>& start = origin.start;
  start.stiffness = of_pair(contacts.rigid_contact_stiffness, m.shape_material_ke, origin.has_ke);
  if (!(sides[0].moves || sides[1].moves) || start.stiffness == 0.0f) return;
  start.damping = of_pair(contacts.rigid_contact_damping, m.shape_material_kd, origin.has_kd);
  start.mu = of_pair(contacts.rigid_contact_friction, m.shape_material_mu, origin.has_mu);
  start.normal = contacts.rigid_contact_normal.data()[slot];
  start.margin[0] = contacts.rigid_contact_margin0.data()[slot];
  start.margin[1] = contacts.rigid_contact_margin1.data()[slot];
  start.point[0] = contacts.rigid_contact_point0.data()[slot];
  start.point[1] = contacts.rigid_contact_point1.data()[slot];
  Vec3f points[2];
  for (int k = 0; k < 2; ++k) {
    start.pose[k] = sides[k].pose;
    if (c.body[k] >= 0) start.com[k] = m.body_com.data()[c.body[k]];
    points[k] = math::transform_point(start.pose[k], start.point[k]);
  }
  start_contact(start, points, dt_, c);
  const Vec3f n = c.normal;
  const Perpendicular p = perpendicular(n);
  float w[3];
  for (int k = 0; k < 3; ++k)
    w[k] = sides[0].mobility(c.arm[0], p.t[k]) + sides[1].mobility(c.arm[1], p.t[k]);
  c.rho = metric(dt_, w[2]);
  c.rho_t = metric(dt_, std::max(w[0], w[1]));
  const auto velocity = [&](int k) {
    const SpatialVectorf qd = c.body[k] < 0 ? SpatialVectorf{} : in.body_qd.data()[c.body[k]];
    return math::motion_at(qd, c.arm[k]).linear;
  };
  recall_contact(contacts, slot, math::dot(n, velocity(0) - velocity(1)), c);
  c.gap += c.ignored;
  contact_.push_back(c);
  contact_origin_.push_back(origin);
  contact_slots_.push_back(static_cast<int32_t>(slot));
}

// Starts from the multipliers of the previous step, if the direction of the normal has hardly
// changed. If both shapes had no contact in that step, ignores the depth that their speed of
// approach (m/s) does not explain. They would be thrown apart otherwise.
void Bodies::recall_contact(const Contacts& contacts, size_t slot, float approach,
                            VbdBodyContact& to) {
  const auto* const memory = memory_at<ContactMemory>(contacts_at());
  const std::tuple key(contacts.rigid_contact_shape0.data()[slot],
                       contacts.rigid_contact_shape1.data()[slot],
                       contacts.rigid_contact_point_id.data()[slot]);
  const auto found = std::lower_bound(
      recalled_.begin(), recalled_.end(), key,
      [memory](int32_t k, const auto& other) { return key_of(memory[k]) < other; });
  if (found == recalled_.end() || key_of(memory[*found]) != key) {
    const auto is_of_pair = [&](auto at) {
      return std::pair(memory[*at].shape[0], memory[*at].shape[1]) ==
             std::pair(std::get<0>(key), std::get<1>(key));
    };
    const bool is_known = (found != recalled_.end() && is_of_pair(found)) ||
                          (found != recalled_.begin() && is_of_pair(found - 1));
    if (!is_known) to.ignored = std::max(0.0f, -to.gap - (kRise + std::max(0.0f, approach)) * dt_);
    return;
  }
  const ContactMemory& before = memory[*found];
  to.ignored = std::max(0.0f, before.ignored - kRise * dt_);
  if (math::dot(before.normal, to.normal) < kLeastCosine) return;
  to.lam_n = kRecall * before.lam_n;
  const Vec3f along = before.lam_t - to.normal * math::dot(to.normal, before.lam_t);
  to.lam_t = within(along * kRecall, to.mu * to.lam_n);
}

// Stores the multipliers for the next step, and writes the forces on shape B of each contact.
void Bodies::keep_contacts(const Contacts* contacts) {
  auto* const memory = memory_at<ContactMemory>(contacts_at());
  for (size_t k = 0; k < contact_rows_ && (k < contact_.size() || memory[k].is_used != 0.0f); ++k)
    memory[k].is_used = 0.0f;
  if (contacts == nullptr) return;
  Vec3f* const forces = DeviceArray<Vec3f>(contacts->rigid_contact_force).mutable_data();
  std::fill_n(forces, contacts->rigid_contact_force.rows(), Vec3f{});
  for (size_t k = 0; k < contact_.size(); ++k) {
    const VbdBodyContact& c = contact_[k];
    const auto slot = at(contact_slots_[k]);
    memory[k] = {.shape = {contacts->rigid_contact_shape0.data()[slot],
                           contacts->rigid_contact_shape1.data()[slot]},
                 .point = contacts->rigid_contact_point_id.data()[slot],
                 .lam_n = c.lam_n,
                 .lam_t = c.lam_t,
                 .is_used = 1.0f,
                 .normal = c.normal,
                 .ignored = c.ignored};
    const float depth = contact_depth(c, motion_of(motion_.data(), c.body[0]),
                                      motion_of(motion_.data(), c.body[1]));
    const float damping = contact_damping(c, depth) * (depth + c.gap);
    forces[slot] = c.normal * (c.lam_n + damping) + c.lam_t;
  }
}

}  // namespace novaphy::vbd
