// From the adjoints of forces and rows to the derivatives with respect to the inputs of a step.
#include <algorithm>

#include "bodies_adjoint.h"

namespace novaphy::vbd {
namespace {

using Vec3d = Vec3<double>;

double wide(float v) { return static_cast<double>(v); }
Vec3d wide(const Vec3f& v) { return {wide(v.x), wide(v.y), wide(v.z)}; }
Quat<double> wide(const Quatf& q) { return {wide(q.x), wide(q.y), wide(q.z), wide(q.w)}; }
Vec3d at(const float* v) { return {wide(v[0]), wide(v[1]), wide(v[2])}; }
double& part(Vec3d& v, int k) { return k == 0 ? v.x : k == 1 ? v.y : v.z; }

double product(const Row6& a, const SpatialVector<DualFloat>& b) {
  return ((a[0] * wide(b.linear.x.d) + a[1] * wide(b.linear.y.d)) + a[2] * wide(b.linear.z.d)) +
         ((a[3] * wide(b.angular.x.d) + a[4] * wide(b.angular.y.d)) + a[5] * wide(b.angular.z.d));
}

// Rows of an array of adjoints. Zeros if the array has no rows.
struct Adjoints {
  const float* rows;
  size_t width;
  std::vector<float> zeros;
  Adjoints(const Array& array, size_t width_of_row)
      : rows(static_cast<const float*>(array.rows() != 0 ? array.raw() : nullptr)),
        width(width_of_row),
        zeros(width_of_row) {}
  const float* of(size_t row) const { return rows != nullptr ? rows + width * row : zeros.data(); }
};

}  // namespace

struct BodiesAdjoint::Gradients {
  explicit Gradients(const VbdBodyDerivatives& d, size_t bodies)
      : body_q(d.body_q),
        body_qd(d.body_qd),
        body_f(d.body_f),
        gravity(d.gravity),
        body_mass(d.body_mass),
        body_inertia(d.body_inertia),
        joint_f(d.joint_f),
        target(d.joint_target_q),
        rate(d.joint_target_qd),
        ke(d.joint_target_ke),
        kd(d.joint_target_kd),
        damping(d.joint_damping),
        armature(d.joint_armature),
        friction(d.joint_friction),
        contact_ke(d.shape_material_ke),
        contact_kd(d.shape_material_kd),
        contact_mu(d.shape_material_mu),
        turn(bodies) {}
  void write() {
    for (Sums* const sums : {&body_q, &body_qd, &body_f, &gravity, &body_mass, &body_inertia,
                             &joint_f, &target, &rate, &ke, &kd, &damping, &armature, &friction,
                             &contact_ke, &contact_kd, &contact_mu})
      sums->write();
  }
  Sums body_q, body_qd, body_f, gravity, body_mass, body_inertia;
  Sums joint_f, target, rate, ke, kd, damping, armature, friction;
  Sums contact_ke, contact_kd, contact_mu;
  std::vector<Vec3d> turn;  // by the rotation of each body at the start, world frame
};

void BodiesAdjoint::Sums::write() {
  if (of.empty()) return;
  auto* const rows = static_cast<float*>(to.raw_mutable());
  for (size_t k = 0; k < of.size(); ++k) rows[k] = static_cast<float>(of[k]);
}

template <class At, class Seed>
double BodiesAdjoint::along(const Pair<At>& j, const Seed& seed) const {
  At at = j.at;
  seed(at);
  const DualValues values = values_of(at, step_.dt);
  double sum = 0.0;
  for (int s = 0; s < 2; ++s)
    if (moves(j.body[s])) sum += product(mu_[index(j.body[s])], values.on[s]);
  for (int k = 0; k < j.at.count; ++k) sum += j.nu[k] * wide(values.error[k].d);
  return -sum;
}

template <class Seed>
double BodiesAdjoint::along(int32_t body, const DualBody& base, const Seed& seed) const {
  DualBody at = base;
  seed(at);
  return -product(mu_[index(body)], force_on(at, step_.dt));
}

KrylovResult BodiesAdjoint::run(const VbdBodyDerivatives& adjoints,
                                const VbdBodyDerivatives& gradients, int32_t sweeps) {
  Gradients to(gradients, load_.size());
  take_results(adjoints, to);
  const KrylovResult result = solve(sweeps);
  pull_bodies(to);
  for_pairs([&](const auto& pair) { pull_poses(pair, to); });
  for (const Joint& j : joint_) pull_axis(j, to);
  for (const Touch& t : touch_) pull_material(t, to);
  pull_kinematic(to);
  for (size_t b = 0; b < to.turn.size(); ++b) {
    const Vec3d& w = to.turn[b];
    const Quat<double> by =
        math::multiply(Quat<double>{w.x, w.y, w.z, 0.0}, wide(step_.in.body_q.data()[b].q));
    const double of[4] = {by.x, by.y, by.z, by.w};
    for (size_t k = 0; k < 4; ++k) to.body_q.add(7 * b + 3 + k, 2.0 * of[k]);
  }
  to.write();
  return result;
}

// Computes the adjoint of each motion from those of the results, and the derivatives of the results
// with respect to the start that do not go through the motion.
void BodiesAdjoint::take_results(const VbdBodyDerivatives& adjoints, Gradients& to) {
  const Adjoints by_q(adjoints.body_q, 7), by_qd(adjoints.body_qd, 6);
  const double by_h = 1.0 / wide(step_.dt);
  for (size_t b = 0; b < load_.size(); ++b) {
    const VbdBodyMotion& motion = step_.solution.motion[b];
    const Transformf& start = step_.in.body_q.data()[b];
    const Vec3f& com = step_.model.body_com.data()[b];
    const Quatf after = unit(math::multiply(motion.turned, start.q));
    const float* const q = by_q.of(b);
    const float* const qd = by_qd.of(b);
    const Vec3d p = at(q);
    const Quat<double> by_turn = math::multiply(
        Quat<double>{wide(q[3]), wide(q[4]), wide(q[5]), wide(q[6])},
        math::conjugate(wide(after)));
    const Vec3d turn = Vec3d{by_turn.x, by_turn.y, by_turn.z} * 0.5 -
                       math::cross(wide(math::rotate(after, com)), p);
    Vec3d moved = p, turned = turn;
    if (row_[b] >= 0) {
      const Vec3f by_rate = {qd[3], qd[4], qd[5]};
      moved = moved + at(qd) * by_h;
      turned = turned + wide(inverse_left_jacobian_transposed(motion.turned, motion.turn, by_rate)) *
                            by_h;
    } else {
      for (size_t k = 0; k < 6; ++k) to.body_qd.add(6 * b + k, wide(qd[k]));
    }
    load_[b] = {moved.x, moved.y, moved.z, turned.x, turned.y, turned.z};
    for (int k = 0; k < 3; ++k) to.body_q.add(7 * b + static_cast<size_t>(k), wide(q[k]));
    to.turn[b] = math::cross(wide(math::rotate(start.q, com)), p) +
                 math::rotate_inverse(wide(motion.turned), turn);
  }
}

void BodiesAdjoint::pull_bodies(Gradients& to) const {
  const Model& m = step_.model;
  for (int32_t body = 0; body < static_cast<int32_t>(load_.size()); ++body) {
    if (!moves(body)) continue;
    const size_t b = index(body);
    const DualBody base = body_at(body);
    const int32_t world = m.body_world.data()[b];
    const size_t g = index(world < 0 ? m.world_count() - 1 : world);
    for (int k = 0; k < 3; ++k) {
      const auto by = [&](const auto& of) {
        return along(body, base, [&](DualBody& d) { vbd::part(of(d.start), k).d = 1.0f; });
      };
      using Start = BodyStart<DualFloat>;
      const size_t linear = 6 * b + static_cast<size_t>(k), angular = linear + 3;
      part(to.turn[b], k) +=
          along(body, base, [&](DualBody& d) { turn_about(d.start.q, k); });
      to.body_qd.add(linear, by([](Start& s) -> auto& { return s.qd.linear; }));
      to.body_qd.add(angular, by([](Start& s) -> auto& { return s.qd.angular; }));
      to.body_f.add(linear, by([](Start& s) -> auto& { return s.f.linear; }));
      to.body_f.add(angular, by([](Start& s) -> auto& { return s.f.angular; }));
      to.gravity.add(3 * g + static_cast<size_t>(k),
                     by([](Start& s) -> auto& { return s.gravity; }));
    }
    pull_mass(body, base, to);
  }
}

void BodiesAdjoint::pull_mass(int32_t body, const DualBody& base, Gradients& to) const {
  const size_t b = index(body);
  if (!to.body_mass.of.empty())
    to.body_mass.add(b, along(body, base, [](DualBody& d) {
                       d.start.mass.d = 1.0f;
                       d.start.inv_mass.d = -d.start.inv_mass.v * d.start.inv_mass.v;
                     }));
  if (to.body_inertia.of.empty()) return;
  for (size_t i = 0; i < 3; ++i)
    for (size_t k = 0; k <= i; ++k) {
      const double by = along(body, base, [&](DualBody& d) {
        d.start.inertia.m[i][k].d = d.start.inertia.m[k][i].d = i == k ? 1.0f : 0.5f;
      });
      to.body_inertia.add(9 * b + 3 * i + k, by);
      if (i != k) to.body_inertia.add(9 * b + 3 * k + i, by);
    }
}

template <class At>
void BodiesAdjoint::pull_poses(const Pair<At>& j, Gradients& to) {
  for (int s = 0; s < 2; ++s) {
    if (j.body[s] < 0) continue;
    const size_t b = index(j.body[s]);
    for (int k = 0; k < 3; ++k) {
      const auto n = static_cast<size_t>(k);
      to.body_q.add(7 * b + n,
                    along(j, [&](At& d) { vbd::part(start_pose(d, s).p, k).d = 1.0f; }));
      part(to.turn[b], k) += along(j, [&](At& d) { turn_about(start_pose(d, s).q, k); });
      if (moves(j.body[s])) continue;
      for (const int c : {k, k + 3})
        load_[b][static_cast<size_t>(c)] += along(j, [&](At& d) {
          DualMotion& m = d.motion[s];
          if (c < 3) {
            vbd::part(m.moved, c).d = 1.0f;
          } else {
            turn_about(m.turned, c - 3);
          }
        });
    }
  }
}

void BodiesAdjoint::pull_axis(const Joint& j, Gradients& to) const {
  using Axis = JointAxis<DualFloat>;
  const auto dof = index(step_.model.joint_qd_start.data()[j.index]);
  const auto add = [&](Sums& sums, size_t k, DualFloat Axis::*of) {
    if (!sums.of.empty())
      sums.add(k, along(j, [&](DualJoint& d) { (d.start.of_axis.*of).d = 1.0f; }));
  };
  if (j.at.start.kind == VbdBodyJointKind::Rod) {
    for (size_t k = 0; k < 6; ++k) {
      if (!to.ke.of.empty())
        to.ke.add(dof + k, along(j, [&](DualJoint& d) { d.start.rod_ke[k].d = 1.0f; }));
      if (!to.kd.of.empty())
        to.kd.add(dof + k, along(j, [&](DualJoint& d) { d.start.rod_kd[k].d = 1.0f; }));
    }
  }
  if (!has_coordinate(j.at.start.kind)) return;
  for (int s = 0; s < 2; ++s) {  // the rate acts by the armature
    if (j.body[s] < 0) continue;
    for (int k = 0; k < 3; ++k) {
      const size_t linear = 6 * index(j.body[s]) + static_cast<size_t>(k);
      using V = SpatialVector<DualFloat>;
      const auto by = [&](Vec3<DualFloat> V::*of) {
        return along(j, [&](DualJoint& d) { vbd::part(d.start.side[s].qd.*of, k).d = 1.0f; });
      };
      to.body_qd.add(linear, by(&V::linear));
      to.body_qd.add(linear + 3, by(&V::angular));
    }
  }
  const DriveUse use = drive_use(step_.model, dof);
  add(to.joint_f, dof, &Axis::force);
  if (use.spring) {
    add(to.target, index(step_.model.joint_q_start.data()[j.index]), &Axis::target);
    add(to.ke, dof, &Axis::ke);
  }
  if (use.spring || use.rate) add(to.kd, dof, &Axis::kd);
  if (use.rate) add(to.rate, dof, &Axis::target_rate);
  add(to.damping, dof, &Axis::damping);
  add(to.armature, dof, &Axis::armature);
  add(to.friction, dof, &Axis::friction);
}

// A coefficient of the pair is half the sum of those of the shapes, unless the row has its own.
void BodiesAdjoint::pull_material(const Touch& t, Gradients& to) const {
  const ContactOrigin& origin = step_.solution.contact_origin[t.index];
  const auto add = [&](Sums& sums, bool of_row, DualFloat ContactStart<DualFloat>::*of) {
    if (sums.of.empty() || of_row) return;
    const double half = 0.5 * along(t, [&](DualContact& d) { (d.start.*of).d = 1.0f; });
    for (const int32_t shape : origin.shape) sums.add(index(shape), half);
  };
  add(to.contact_ke, origin.has_ke, &ContactStart<DualFloat>::stiffness);
  add(to.contact_kd, origin.has_kd, &ContactStart<DualFloat>::damping);
  add(to.contact_mu, origin.has_mu, &ContactStart<DualFloat>::mu);
}

// A kinematic body moves by h v and by exp(h w).
void BodiesAdjoint::pull_kinematic(Gradients& to) const {
  const float h = step_.dt;
  for (size_t b = 0; b < load_.size(); ++b) {
    if (row_[b] >= 0) continue;
    const Vec3f w = step_.in.body_qd.data()[b].angular * h;
    for (int k = 0; k < 3; ++k) {
      const auto n = static_cast<size_t>(k);
      Vec3<DualFloat> turning = vbd::dual(w);
      vbd::part(turning, k).d = h;
      const Quat<DualFloat> q = exp_rotation(turning);
      const Quatf change =
          math::multiply(Quatf{q.x.d, q.y.d, q.z.d, q.w.d},
                         math::conjugate(Quatf{q.x.v, q.y.v, q.z.v, q.w.v}));
      to.body_qd.add(6 * b + n, wide(h) * load_[b][n]);
      to.body_qd.add(6 * b + 3 + n, 2.0 * ((wide(change.x) * load_[b][3] +
                                            wide(change.y) * load_[b][4]) +
                                           wide(change.z) * load_[b][5]));
    }
  }
}

}  // namespace novaphy::vbd
