// Contacts of bodies and the arrays of the model that their penalty forces need, on the host.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/math/functions.h"

namespace novaphy::detail {

struct TouchingRows {
  TouchingRows(const Model& m, const SimState& state, const Contacts& c, bool pushed,
               const std::vector<uint8_t>* of_bodies)
      : q(state.body_q),
        com(m.body_com),
        flags(m.body_flags),
        body(m.shape_body),
        ke(m.shape_material_ke),
        kd(m.shape_material_kd),
        kf(m.shape_material_kf),
        mu(m.shape_material_mu),
        row_ke(c.rigid_contact_stiffness),
        row_kd(c.rigid_contact_damping),
        row_mu(c.rigid_contact_friction),
        shape0(c.rigid_contact_shape0),
        shape1(c.rigid_contact_shape1),
        point0(c.rigid_contact_point0),
        point1(c.rigid_contact_point1),
        normal(c.rigid_contact_normal),
        force(c.rigid_contact_force),
        margin0(c.rigid_contact_margin0),
        margin1(c.rigid_contact_margin1),
        count(static_cast<size_t>(c.active_rigid_contact_count())),
        is_pushed(pushed),
        bodies(of_bodies) {
    const auto shapes = static_cast<int32_t>(body.size());
    for (size_t k = 0; k < count; ++k)
      require(shape0[k] >= 0 && shape0[k] < shapes && shape1[k] >= 0 && shape1[k] < shapes,
              ErrorKind::Index, "contacts: rigid_contact_shape0, _shape1: expected 0 to ",
              shapes - 1, ", got ", shape0[k], " and ", shape1[k]);
  }

  bool moves(int32_t b) const {
    return b >= 0 && !has_flag(flags[static_cast<size_t>(b)], BodyFlags::KINEMATIC);
  }
  bool counts(int32_t b) const {
    return moves(b) && (bodies == nullptr || (*bodies)[static_cast<size_t>(b)] != 0);
  }
  Transformf pose(int32_t b) const {
    return b < 0 ? Transformf::identity() : q[static_cast<size_t>(b)];
  }
  // A contact row: its shapes, their bodies, points on both surfaces (world), and its overlap (m).
  struct Row {
    size_t shapes[2];
    int32_t bodies[2];
    Vec3f at[2];
    float depth;
  };
  Row row(size_t k) const {
    Row r;
    r.shapes[0] = static_cast<size_t>(shape0[k]);
    r.shapes[1] = static_cast<size_t>(shape1[k]);
    for (size_t side = 0; side < 2; ++side) r.bodies[side] = body[r.shapes[side]];
    const Vec3f n = normal[k];
    r.at[0] = math::transform_point(pose(r.bodies[0]), point0[k]) + n * margin0[k];
    r.at[1] = math::transform_point(pose(r.bodies[1]), point1[k]) - n * margin1[k];
    r.depth = -math::dot(n, r.at[1] - r.at[0]);
    return r;
  }
  bool touches(size_t k) const {
    if (!is_pushed) return row(k).depth > 0.0f;
    const Vec3f& f = force[k];
    return f.x != 0.0f || f.y != 0.0f || f.z != 0.0f;
  }
  float mean(const OnHost<float>& of, const Row& r) const {
    return (of[r.shapes[0]] + of[r.shapes[1]]) * 0.5f;
  }
  float own(const OnHost<float>& of_rows, size_t k, float of_shapes) const {
    return of_rows.size() == 0 || !(of_rows[k] > 0.0f) ? of_shapes : of_rows[k];
  }
  float ke_of(size_t k, const Row& r) const { return own(row_ke, k, mean(ke, r)); }
  float kd_of(size_t k, const Row& r) const { return own(row_kd, k, mean(kd, r)); }
  bool slides(size_t k, const Row& r) const { return own(row_mu, k, mean(mu, r)) > 0.0f; }

  const OnHost<Transformf> q;
  const OnHost<Vec3f> com;
  const OnHost<int32_t> flags, body;
  const OnHost<float> ke, kd, kf, mu, row_ke, row_kd, row_mu;
  const OnHost<int32_t> shape0, shape1;
  const OnHost<Vec3f> point0, point1, normal, force;
  const OnHost<float> margin0, margin1;
  const size_t count;
  const bool is_pushed;
  const std::vector<uint8_t>* const bodies;
};

}  // namespace novaphy::detail
