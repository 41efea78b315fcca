#include "touch_rows.h"

#include <algorithm>
#include <cmath>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/spatial.h"

namespace novaphy::diff::detail {
namespace {

using math::cross;
using math::dot;

Vec3d wide(const Vec3f& a) { return {a.x, a.y, a.z}; }
int32_t rows_of(const DeviceArray<int32_t>& of) { return static_cast<int32_t>(of.rows()); }

// Coefficients of the penalty law at the gap d and the normal velocity un. The normal force is n
// (ke d + kd min(un, 0)). The Coulomb limit is -mu (ke d + kd_of_cone min(un, 0)).
struct TouchLaw {
  double ke, kd, kd_of_cone, kf, mu, smoothing;
};

// The force of an overlapping contact, and its derivatives by the gap and by the relative velocity
// u.
struct TouchForce {
  Vec3d force{}, by_gap{};
  Columns3 by_velocity{};
  bool slides = false;
};
TouchForce force_inside(const TouchLaw& law, const Vec3d& n, double gap, const Vec3d& u) {
  TouchForce f;
  const double un = dot(n, u), closing = std::min(un, 0.0), kd = un < 0.0 ? law.kd : 0.0;
  const Vec3d ut = u - n * un;
  f.force = n * (law.ke * gap + law.kd * closing);
  f.by_gap = n * law.ke;
  const double cone = -law.mu * (law.ke * gap + law.kd_of_cone * closing);
  const double slip = std::sqrt(dot(ut, ut)), e = law.smoothing;
  const double h = slip < e ? (slip * slip + e * e) / (2.0 * e) : slip;
  const bool slides = law.kf * h > cone;
  const double slope = slides ? (h > 0.0 ? cone / h : 0.0) : law.kf;
  if (law.kf > 0.0 && cone >= 0.0) {
    f.slides = slides;
    f.force = f.force + ut * slope;
    if (slides && h > 0.0) f.by_gap = f.by_gap + ut * (-law.mu * law.ke / h);
  }
  const std::array<Vec3d, 3> axes = {Vec3d{1, 0, 0}, Vec3d{0, 1, 0}, Vec3d{0, 0, 1}};
  for (size_t k = 0; k < 3; ++k) {
    const double dn = dot(n, axes[k]);
    f.by_velocity[k] = n * (kd * dn);
    if (!(law.kf > 0.0 && cone >= 0.0)) continue;
    const Vec3d dt = axes[k] - n * dn;
    f.by_velocity[k] = f.by_velocity[k] + dt * slope;
    if (!slides || !(h > 0.0)) continue;
    const double dh = dot(ut, dt) / (slip < e ? e : slip);
    const double dcone = un < 0.0 ? -law.mu * law.kd_of_cone * dn : 0.0;
    f.by_velocity[k] = f.by_velocity[k] + ut * (dcone / h - cone * dh / (h * h));
  }
  return f;
}

// Evaluates the law for a row. The law acts below the gap `reach` (m). inverse_mass(direction)
// returns the inverse mass (1/kg) of the contact along a unit vector.
template <class InverseMass>
void apply(const TouchLaw& law, const Vec3d& u, double reach, float dt,
           const InverseMass& inverse_mass, TouchRow& row) {
  row.inverse_mass = inverse_mass(row.normal);
  row.speed = dot(row.normal, u);
  row.stiffness = law.ke;
  row.speed_taken = law.kd * double{dt} * row.inverse_mass;
  const Vec3d ut = u - row.normal * dot(row.normal, u);
  const double slip = std::sqrt(dot(ut, ut));
  if (law.mu > 0.0 && slip > 0.0)
    row.slip_taken = double{dt} * law.kf * inverse_mass(ut * (1.0 / slip));
  row.adheres = reach > 0.0;
  row.pushes = row.gap < reach;
  if (row.pushes) {
    const TouchForce now = force_inside(law, row.normal, row.gap, u);
    row.force = now.force;
    row.slides = law.mu > 0.0 && now.slides;
  }
  const double half = 0.5 * double{dt} * std::abs(row.speed);
  row.ramp = !row.adheres && std::abs(row.gap) < half;
  if (!row.ramp) return;
  const double part = 0.5 - row.gap / (2.0 * half) - (row.pushes ? 1.0 : 0.0);
  const TouchForce inside = force_inside(law, row.normal, std::min(row.gap, 0.0), u);
  const Vec3d jump = force_inside(law, row.normal, 0.0, u).force;
  row.by_gap = inside.by_gap * part - jump * (0.5 / half);
  for (size_t k = 0; k < 3; ++k) row.by_velocity[k] = inside.by_velocity[k] * part;
}

// The bodies of a state, with their shapes' sides.
struct TouchBodies {
  const Model& model;
  const Transformf* q;
  const SpatialVectorf* qd;
  TouchBodies(const Model& m, const StateFields& state)
      : model(m), q(state.body_q.data()), qd(state.body_qd.data()) {}
  TouchSide side(int32_t body, const Vec3d& at) const {
    if (body < 0) return {};
    const Vec3f com = math::transform_point(q[body], model.body_com.data()[body]);
    return {.body = body,
            .responds = model.body_inv_mass.data()[body] > 0.0f &&
                        !has_flag(model.body_flags.data()[body], BodyFlags::KINEMATIC),
            .arm = at - wide(com)};
  }
  Vec3d velocity(const TouchSide& side) const {
    if (side.body < 0) return {};
    const SpatialVectorf& v = qd[side.body];
    return wide(v.linear) + cross(wide(v.angular), side.arm);
  }
  double inverse_mass(const TouchSide& side, const Vec3d& n) const {
    if (!side.responds) return 0.0;
    const auto b = static_cast<size_t>(side.body);
    const Vec3d turn = cross(side.arm, n);
    const Vec3f in_body = math::rotate_inverse(
        q[b].q,
        Vec3f{static_cast<float>(turn.x), static_cast<float>(turn.y), static_cast<float>(turn.z)});
    const Vec3f by = math::multiply(model.body_inv_inertia.data()[b], in_body);
    return double{model.body_inv_mass.data()[b]} + double{math::dot(in_body, by)};
  }
};

void find_rigid(const Model& m, const StateFields& state, const ContactFields& c,
                const TouchOptions& options, std::vector<TouchRow>& rows) {
  const TouchBodies bodies(m, state);
  const int32_t* const shape_body = m.shape_body.data();
  const auto material = [&](int32_t s) {
    return RigidContactMaterial<float>{m.shape_material_ke.data()[s], m.shape_material_kd.data()[s],
                                       m.shape_material_kf.data()[s], m.shape_material_ka.data()[s],
                                       m.shape_material_mu.data()[s]};
  };
  const int32_t count = filled_rows(*c.rigid_contact_count.data(), rows_of(c.rigid_contact_shape0),
                                    c.rigid_contact_shape0.data());
  for (int32_t i = 0; i < count; ++i) {
    const int32_t s0 = c.rigid_contact_shape0.data()[i], s1 = c.rigid_contact_shape1.data()[i];
    if (s0 < 0 || s1 < 0) continue;
    RigidContactMaterial<float> of = mean_rigid_contact_material(material(s0), material(s1));
    if (c.rigid_contact_stiffness.rows() > 0)
      of = rigid_contact_material_of_row(of, c.rigid_contact_stiffness.data()[i],
                                         c.rigid_contact_damping.data()[i],
                                         c.rigid_contact_friction.data()[i]);
    const int32_t b0 = shape_body[s0], b1 = shape_body[s1];
    const Vec3f n = -c.rigid_contact_normal.data()[i];
    const auto at = [&](int32_t body, const Vec3f& point) {
      return body < 0 ? point : math::transform_point(bodies.q[body], point);
    };
    // The order of operations is that of rigid_contact_force_at, so that the bits are the same.
    const Vec3f p0 = at(b0, c.rigid_contact_point0.data()[i]) -
                     n * c.rigid_contact_margin0.data()[i],
                p1 = at(b1, c.rigid_contact_point1.data()[i]) +
                     n * c.rigid_contact_margin1.data()[i];
    const Vec3f meet = b0 < 0 ? p1 : b1 < 0 ? p0 : (p0 + p1) * 0.5f;
    TouchRow row;
    row.row = i;
    row.first = s0;
    row.second = s1;
    row.point = c.rigid_contact_point_id.data()[i];
    row.sides = {bodies.side(b0, wide(meet)), bodies.side(b1, wide(meet))};
    row.normal = wide(n);
    row.gap = math::dot(n, p0 - p1);
    const auto inverse_mass = [&](const Vec3d& along) {
      return bodies.inverse_mass(row.sides[0], along) + bodies.inverse_mass(row.sides[1], along);
    };
    apply({of.ke, of.kd, of.kd, of.kf, of.mu, options.smoothing},
          bodies.velocity(row.sides[0]) - bodies.velocity(row.sides[1]), of.ka, options.dt,
          inverse_mass, row);
    if (row.pushes || row.ramp) rows.push_back(row);
  }
}

void find_soft(const Model& m, const StateFields& state, const ContactFields& c,
               const TouchOptions& options, std::vector<TouchRow>& rows) {
  const TouchBodies bodies(m, state);
  const SoftContactMaterial<float> of_model{m.soft_contact_ke, m.soft_contact_kd, m.soft_contact_kf,
                                            m.soft_contact_mu};
  const int32_t count = std::min(*c.soft_contact_count.data(), rows_of(c.soft_contact_shape));
  for (int32_t i = 0; i < count; ++i) {
    const int32_t p = c.soft_contact_particle.data()[i], s = c.soft_contact_shape.data()[i];
    if (p < 0 || s < 0) continue;
    const int32_t b = m.shape_body.data()[s];
    const auto of_shape = [s](const DeviceArray<float>& a) { return a.data()[s]; };
    const float mass = m.particle_mass.data()[p];
    const auto of = with_bounded_kf(
        mean_soft_contact_material<float>(
            of_model, {of_shape(m.shape_material_ke), of_shape(m.shape_material_kd),
                       of_shape(m.shape_material_kf), of_shape(m.shape_material_mu)}),
        mass, options.kf_rate);
    SoftContactBody<float> at{
        c.soft_contact_body_pos.data()[i], c.soft_contact_body_vel.data()[i], {}};
    if (b >= 0)
      at = soft_contact_body(bodies.q[b], bodies.qd[b], m.body_com.data()[b], at.position,
                             at.velocity);
    const Vec3f n = c.soft_contact_normal.data()[i];
    TouchRow row;
    row.row = i;
    row.first = s;
    row.second = ContactPair::kParticle + p;
    const float inv_mass = m.particle_inv_mass.data()[p];
    row.sides = {TouchSide{.particle = p, .responds = inv_mass > 0.0f},
                 bodies.side(b, wide(at.position))};
    row.normal = wide(n);
    row.gap = math::dot(n, state.particle_q.data()[p] - at.position) - m.particle_radius.data()[p];
    const auto inverse_mass = [&](const Vec3d& along) {
      return double{inv_mass} + bodies.inverse_mass(row.sides[1], along);
    };
    apply({of.ke, of.kd, 0.0, of.kf, of.mu, 0.0},
          wide(state.particle_qd.data()[p]) - wide(at.velocity), m.particle_adhesion, options.dt,
          inverse_mass, row);
    if (row.pushes || row.ramp) rows.push_back(row);
  }
}

}  // namespace

void find_touches(const Model& model, const StateFields& state, const ContactFields& contacts,
                  const TouchOptions& options, std::vector<TouchRow>& rows) {
  rows.clear();
  if (options.soft && rows_of(contacts.soft_contact_shape) > 0)
    find_soft(model, state, contacts, options, rows);
  if (options.rigid && rows_of(contacts.rigid_contact_shape0) > 0)
    find_rigid(model, state, contacts, options, rows);
}

}  // namespace novaphy::diff::detail
