#include "rigid_bodies.h"

#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/dynamics/semi_implicit/rigid_integrator_trace.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

constexpr int64_t kRowChunk = 128, kBodyChunk = 128;

}  // namespace

void RigidBodies::prepare(const Model& m, const Contacts* contacts) {
  if (contacts == nullptr) return;
  const Contacts& c = *contacts;
  c.check_materials("step");
  if (count_.matches(c.rigid_contact_count) && shape0_.matches(c.rigid_contact_shape0) &&
      shape1_.matches(c.rigid_contact_shape1) && shape_body_.matches(m.shape_body)) {
    return;
  }
  count_.reset();
  rows_ = filled_rows(*c.rigid_contact_count.data(), c.rigid_contact_max(),
                      c.rigid_contact_shape0.data());
  bodies_.resize(2 * static_cast<size_t>(rows_));
  const int32_t* const body = m.shape_body.data();
  const int32_t* const shapes[2] = {c.rigid_contact_shape0.data(), c.rigid_contact_shape1.data()};
  for (int32_t row = 0; row < rows_; ++row) {
    for (int side = 0; side < 2; ++side) {
      const int32_t shape = shapes[side][row];
      require(shape >= 0 && shape < m.shape_count(), ErrorKind::Index,
              "step: contacts: rigid_contact_shape", side, "[", row, "]: expected 0 to ",
              m.shape_count() - 1, ", got ", shape);
      require(body[shape] >= -1 && body[shape] < m.body_count(), ErrorKind::Index,
              "step: model.shape_body[", shape, "]: expected -1 to ", m.body_count() - 1, ", got ",
              body[shape]);
      bodies_[2 * static_cast<size_t>(row) + static_cast<size_t>(side)] = body[shape];
    }
  }
  sides_.build(bodies_, m.body_count());
  wrenches_.resize(bodies_.size());
  count_.set(c.rigid_contact_count);
  shape0_.set(c.rigid_contact_shape0);
  shape1_.set(c.rigid_contact_shape1);
  shape_body_.set(m.shape_body);
}

void RigidBodies::evaluate(const Model& m, const Transformf* q, const SpatialVectorf* qd,
                           const Contacts& c, const RigidStep& how) {
  const Vec3f* const com = m.body_com.data();
  const int32_t* const shape0 = c.rigid_contact_shape0.data();
  const int32_t* const shape1 = c.rigid_contact_shape1.data();
  const Vec3f* const point0 = c.rigid_contact_point0.data();
  const Vec3f* const point1 = c.rigid_contact_point1.data();
  const float* const margin0 = c.rigid_contact_margin0.data();
  const float* const margin1 = c.rigid_contact_margin1.data();
  const Vec3f* const normal = c.rigid_contact_normal.data();
  const float *const ke = m.shape_material_ke.data(), *const kd = m.shape_material_kd.data(),
                     *const kf = m.shape_material_kf.data(), *const ka = m.shape_material_ka.data(),
                     *const mu = m.shape_material_mu.data();
  const bool of_rows = c.per_contact_shape_properties();
  const float *const row_ke = c.rigid_contact_stiffness.data(),
                     *const row_kd = c.rigid_contact_damping.data(),
                     *const row_mu = c.rigid_contact_friction.data();
  DeviceArray<Vec3f> forces = c.rigid_contact_force;
  Vec3f* const force = forces.mutable_data();

  const auto side = [&](int32_t body, const Vec3f& point, float margin) {
    RigidContactSide<float> s;
    if (body >= 0) s = {.pose = q[body], .twist = qd[body], .com = com[body], .is_body = 1.0f};
    s.point = point;
    s.margin = margin;
    return s;
  };
  const auto material = [&](int32_t s) {
    return RigidContactMaterial<float>{ke[s], kd[s], kf[s], ka[s], mu[s]};
  };
  const bool sticks = how.stick_ke > 0.0f;
  const RigidContactLaw<float> law = {how.friction_law, how.friction_smoothing, how.penalty_law,
                                      0.5f * how.dt};
  for_chunks(rows_, kRowChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t row = begin; row < end; ++row) {
      const size_t first = 2 * static_cast<size_t>(row);
      const RigidContactSide<float> a = side(bodies_[first], point0[row], margin0[row]),
                                    b = side(bodies_[first + 1], point1[row], margin1[row]);
      RigidContactMaterial<float> both =
          mean_rigid_contact_material(material(shape0[row]), material(shape1[row]));
      if (of_rows)
        both = rigid_contact_material_of_row(both, row_ke[row], row_kd[row], row_mu[row]);
      const float kf_of_row = both.kf;
      if (sticks) both.kf = 0.0f;  // the stick springs replace viscous friction
      RigidContactForce<float> f = rigid_contact_force(law, a, b, normal[row], both);
      if (sticks) {
        const Vec3f n = -normal[row];
        const Vec3f u = (a.twist.linear + math::cross(a.twist.angular, f.arm_a)) -
                        (b.twist.linear + math::cross(b.twist.angular, f.arm_b));
        f.force = f.force + sticks_.friction(row, n, u - n * math::dot(n, u),
                                             -both.mu * math::dot(n, f.force), kf_of_row,
                                             how.stick_ke, how.dt);
      }
      // acc + (-f) has the same bits as acc - f.
      wrenches_[first] = {-f.force, -math::cross(f.arm_a, f.force)};
      wrenches_[first + 1] = {f.force, math::cross(f.arm_b, f.force)};
      force[row] = f.force;
    }
  });
}

void RigidBodies::add_contact_wrenches(const Model& m, const Transformf* q,
                                       const SpatialVectorf* qd, const Contacts& contacts,
                                       const RigidStep& how, SpatialVectorf* wrenches) {
  evaluate(m, q, qd, contacts, how);
  for_chunks(m.body_count(), kBodyChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t b = begin; b < end; ++b)
      for (const int32_t item : sides_.items(b))
        wrenches[b] = wrenches[b] + wrenches_[static_cast<size_t>(item)];
  });
}

// Finds the bodies that sleep, after waking the bodies that contacts and forces act on.
void RigidBodies::find_sleepers(const Model& m, const SimState& in, const Contacts* contacts,
                                const JointForces& joints, const ParticleContacts* particles,
                                SleepStep& sleep) {
  sleep.begin(m, in);
  if (contacts != nullptr) sleep.wake_touched(m, in, *contacts, bodies_, 0.0f);
  if (joints.empty() && particles == nullptr) return;
  forced_.clear();
  for (int32_t b = 0; b < m.body_count(); ++b) {
    SpatialVectorf wrench{};
    if (!joints.empty()) wrench = joints.add(b, wrench);
    if (particles != nullptr) wrench = particles->add(b, wrench);
    if (!(wrench == SpatialVectorf{})) forced_.push_back(b);
  }
  sleep.wake_forced(forced_);
}

void RigidBodies::step(const Model& m, const SimState& in, SimState& out, const Contacts* contacts,
                       const JointForces& joints, const ParticleContacts* particles,
                       const RigidStep& how, ContactWatch& watch, SleepStep* sleep) {
  if (m.body_count() == 0) return;
  const bool touching = contacts != nullptr && rows_ > 0;
  if (touching && how.stick_ke > 0.0f) sticks_.begin(*contacts, rows_, in.body_q);
  if (touching) evaluate(m, in.body_q.data(), in.body_qd.data(), *contacts, how);
  if (contacts != nullptr && watch.is_due(false)) watch.look(m, in, *contacts, how.dt, true);

  if (sleep != nullptr) find_sleepers(m, in, contacts, joints, particles, *sleep);

  const Transformf* const q = in.body_q.data();
  const SpatialVectorf* const qd = in.body_qd.data();
  const SpatialVectorf* const applied = in.body_f.data();
  const Vec3f* const com = m.body_com.data();
  const float* const inv_mass = m.body_inv_mass.data();
  const Mat33f* const inertia = m.body_inertia.data();
  const Mat33f* const inv_inertia = m.body_inv_inertia.data();
  const int32_t* const flags = m.body_flags.data();
  const int32_t* const world = m.body_world.data();
  const Vec3f* const gravity = m.gravity.data();
  const int32_t last_world = m.world_count() - 1;
  Transformf* const q_out = out.body_q.mutable_data();
  SpatialVectorf* const qd_out = out.body_qd.mutable_data();
  for_chunks(m.body_count(), kBodyChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t b = begin; b < end; ++b) {
      const RigidBodyState<float> now = {q[b], qd[b]};
      RigidBodyState<float> next;
      const bool afloat = sleep != nullptr && sleep->is_afloat(static_cast<int32_t>(b));
      if (sleep != nullptr && sleep->is_asleep(static_cast<int32_t>(b))) {
        next = now;
      } else if (has_flag(flags[b], BodyFlags::KINEMATIC)) {
        next = move_kinematic_body(now, com[b], how.dt);
      } else {
        SpatialVectorf wrench = applied[b];
        if (!joints.empty()) wrench = joints.add(b, wrench);
        if (touching && !afloat)
          for (const int32_t item : sides_.items(b))
            wrench = wrench + wrenches_[static_cast<size_t>(item)];
        if (particles != nullptr) wrench = particles->add(b, wrench);
        next =
            integrate_rigid_body(now, wrench, {com[b], inv_mass[b], inertia[b], inv_inertia[b]},
                                 afloat ? Vec3f{} : gravity[world[b] < 0 ? last_world : world[b]],
                                 how.angular_damping, how.dt, is_of_newton(how.friction_law));
      }
      q_out[b] = next.q;
      qd_out[b] = next.qd;
    }
  });
  if (sleep != nullptr) sleep->end(m, in, out, how.dt);
  if (touching && how.stick_ke > 0.0f) sticks_.end(out.body_q);
}

}  // namespace novaphy
