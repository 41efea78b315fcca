// The tangent of the solution of a step of bodies: the derivative along one direction of the inputs.
#include <algorithm>

#include "bodies_adjoint.h"

namespace novaphy::vbd {
namespace {

double wide(float v) { return static_cast<double>(v); }

// The tangent of an array of floats. An array without rows is 0.
struct Direction {
  explicit Direction(const Array& array)
      : rows(static_cast<const float*>(array.rows() != 0 ? array.raw() : nullptr)) {}
  float at(size_t k) const { return rows != nullptr ? rows[k] : 0.0f; }
  Vec3f vector(size_t k) const { return {at(k), at(k + 1), at(k + 2)}; }
  const float* rows;
};

void put(Vec3<DualFloat>& v, const Vec3f& d) {
  v.x.d = d.x;
  v.y.d = d.y;
  v.z.d = d.z;
}

// Returns the rotation (world frame) of the change dq of a unit quaternion.
Vec3f rotation_of(const Quatf& dq, const Quatf& q) {
  const Quatf by = math::multiply(dq, math::conjugate(q));
  return Vec3f{by.x, by.y, by.z} * 2.0f;
}
Quatf change_of(const Quatf& q, const Vec3f& w) {
  return math::multiply(Quatf{0.5f * w.x, 0.5f * w.y, 0.5f * w.z, 0.0f}, q);
}
void put_turn(Quat<DualFloat>& q, const Vec3f& w) {
  const Quatf d = change_of({q.x.v, q.y.v, q.z.v, q.w.v}, w);
  q.x.d = d.x;
  q.y.d = d.y;
  q.z.d = d.z;
  q.w.d = d.w;
}

}  // namespace

// The tangents of the poses at the start and of the motions, for each body.
struct BodiesAdjoint::Tangents {
  const VbdBodyDerivatives& along;
  std::vector<Vec3f> moved, turned;    // of the origin (m) and of the rotation (rad)
  std::vector<SpatialVectorf> qd;      // m/s, rad/s
  std::vector<SpatialVectorf> motion;  // of the motion in the step (m, rad)
};

template <class At>
void BodiesAdjoint::put_poses(const Pair<At>& j, const Tangents& t, At& at) const {
  for (int s = 0; s < 2; ++s) {
    if (j.body[s] < 0) continue;
    const size_t b = index(j.body[s]);
    put(start_pose(at, s).p, t.moved[b]);
    put_turn(start_pose(at, s).q, t.turned[b]);
    if (moves(j.body[s])) continue;
    put(at.motion[s].moved, t.motion[b].linear);
    put_turn(at.motion[s].turned, t.motion[b].angular);
  }
}

void BodiesAdjoint::put_inputs(const Joint& j, const Tangents& t, DualJoint& at) const {
  const VbdBodyDerivatives& d = t.along;
  for (int s = 0; s < 2; ++s) {
    if (j.body[s] < 0) continue;
    put(at.start.side[s].qd.linear, t.qd[index(j.body[s])].linear);
    put(at.start.side[s].qd.angular, t.qd[index(j.body[s])].angular);
  }
  const auto dof = index(step_.model.joint_qd_start.data()[j.index]);
  if (at.start.kind == VbdBodyJointKind::Rod)
    for (size_t k = 0; k < 6; ++k) {
      at.start.rod_ke[k].d = Direction(d.joint_target_ke).at(dof + k);
      at.start.rod_kd[k].d = Direction(d.joint_target_kd).at(dof + k);
    }
  if (!has_coordinate(at.start.kind)) return;
  const DriveUse use = drive_use(step_.model, dof);
  JointAxis<DualFloat>& axis = at.start.of_axis;
  axis.force.d = Direction(d.joint_f).at(dof);
  if (use.spring) {
    axis.target.d =
        Direction(d.joint_target_q).at(index(step_.model.joint_q_start.data()[j.index]));
    axis.ke.d = Direction(d.joint_target_ke).at(dof);
  }
  if (use.spring || use.rate) axis.kd.d = Direction(d.joint_target_kd).at(dof);
  if (use.rate) axis.target_rate.d = Direction(d.joint_target_qd).at(dof);
  axis.damping.d = Direction(d.joint_damping).at(dof);
  axis.armature.d = Direction(d.joint_armature).at(dof);
  axis.friction.d = Direction(d.joint_friction).at(dof);
}

void BodiesAdjoint::put_inputs(const Touch& j, const Tangents& t, DualContact& at) const {
  const ContactOrigin& origin = step_.solution.contact_origin[j.index];
  const auto mean = [&](const Array& of, bool of_row) {
    const Direction d(of);
    return of_row ? 0.0f : 0.5f * (d.at(index(origin.shape[0])) + d.at(index(origin.shape[1])));
  };
  at.start.stiffness.d = mean(t.along.shape_material_ke, origin.has_ke);
  at.start.damping.d = mean(t.along.shape_material_kd, origin.has_kd);
  at.start.mu.d = mean(t.along.shape_material_mu, origin.has_mu);
}

void BodiesAdjoint::put_inputs(size_t b, const Tangents& t, BodyStart<DualFloat>& to) const {
  const VbdBodyDerivatives& d = t.along;
  const int32_t world = step_.model.body_world.data()[b];
  put_turn(to.q, t.turned[b]);
  put(to.qd.linear, t.qd[b].linear);
  put(to.qd.angular, t.qd[b].angular);
  put(to.f.linear, Direction(d.body_f).vector(6 * b));
  put(to.f.angular, Direction(d.body_f).vector(6 * b + 3));
  put(to.gravity, Direction(d.gravity).vector(
                      3 * index(world < 0 ? step_.model.world_count() - 1 : world)));
  to.mass.d = Direction(d.body_mass).at(b);
  to.inv_mass.d = -to.inv_mass.v * to.inv_mass.v * to.mass.d;
  const Direction inertia(d.body_inertia);
  for (size_t i = 0; i < 3; ++i)
    for (size_t k = 0; k < 3; ++k)
      to.inertia.m[i][k].d =
          0.5f * (inertia.at(9 * b + 3 * i + k) + inertia.at(9 * b + 3 * k + i));
}

// Reads the tangents of the states. Kinematic bodies move by h v and by exp(h w).
BodiesAdjoint::Tangents BodiesAdjoint::tangents_of(const VbdBodyDerivatives& along) const {
  const size_t bodies = row_.size();
  Tangents t = {along, std::vector<Vec3f>(bodies), std::vector<Vec3f>(bodies),
                std::vector<SpatialVectorf>(bodies), std::vector<SpatialVectorf>(bodies)};
  const Direction q(along.body_q), qd(along.body_qd);
  for (size_t b = 0; b < bodies; ++b) {
    const Vec3f v = q.vector(7 * b + 3);
    t.moved[b] = q.vector(7 * b);
    t.turned[b] = rotation_of({v.x, v.y, v.z, q.at(7 * b + 6)}, step_.in.body_q.data()[b].q);
    t.qd[b] = {qd.vector(6 * b), qd.vector(6 * b + 3)};
    if (row_[b] >= 0) continue;
    Vec3<DualFloat> w = dual(step_.in.body_qd.data()[b].angular * step_.dt);
    put(w, t.qd[b].angular * step_.dt);
    const Quat<DualFloat> by = exp_rotation(w);
    t.motion[b] = {t.qd[b].linear * step_.dt,
                   rotation_of({by.x.d, by.y.d, by.z.d, by.w.d}, {by.x.v, by.y.v, by.z.v, by.w.v})};
  }
  return t;
}

// Solves for the tangents of the motions and of the multipliers (nu). `load`: minus the tangents of
// the forces.
KrylovResult BodiesAdjoint::solve_tangent(const std::vector<Row6>& load, int32_t sweeps,
                                          std::vector<Row6>& found) {
  KrylovResult result;
  largest_ = 0.0;
  std::vector<Row6> before(load.size());
  while (result.iterations < sweeps) {
    found = load;
    for_pairs([&](const auto& j) {
      for (int s = 0; s < 2; ++s)
        for (int k = 0; k < j.at.count && moves(j.body[s]); ++k)
          for (size_t r = 0; r < 6; ++r)
            found[row(j.body[s])][r] -= j.by_lam[k][6 * static_cast<size_t>(s) + r] *
                                        (j.stiffness(k) * (j.along[k] + j.nu[k] / j.penalty[k]));
    });
    system_->solve_transposed(found);
    for_pairs([&](auto& j) {
      for (int k = 0; k < j.at.count; ++k) {
        double sum = j.along[k] + j.nu[k] / j.penalty[k];
        for (int s = 0; s < 2; ++s)
          for (size_t c = 0; c < 6 && moves(j.body[s]); ++c)
            sum += j.by_motion[k][6 * static_cast<size_t>(s) + c] * found[row(j.body[s])][c];
        j.nu[k] = j.stiffness(k) * sum;
      }
    });
    if (is_solved(before, found, result)) break;
    before = found;
  }
  return result;
}

KrylovResult BodiesAdjoint::tangent(const VbdBodyDerivatives& along, float* q_out, float* qd_out,
                                    int32_t sweeps) {
  Tangents t = tangents_of(along);
  std::vector<Row6> load(index(rows_)), found;
  const auto subtract = [&](int32_t body, const SpatialVector<DualFloat>& f) {
    const float of[6] = {f.linear.x.d,  f.linear.y.d,  f.linear.z.d,
                         f.angular.x.d, f.angular.y.d, f.angular.z.d};
    for (size_t r = 0; r < 6; ++r) load[row(body)][r] -= wide(of[r]);
  };
  for (int32_t body = 0; body < static_cast<int32_t>(row_.size()); ++body) {
    if (!moves(body)) continue;
    DualBody at = body_at(body);
    put_inputs(index(body), t, at.start);
    subtract(body, force_on(at, step_.dt));
  }
  for_pairs([&](auto& j) {
    auto at = j.at;
    put_poses(j, t, at);
    put_inputs(j, t, at);
    const DualValues values = values_of(at, step_.dt);
    for (int s = 0; s < 2; ++s)
      if (moves(j.body[s])) subtract(j.body[s], values.on[s]);
    for (int k = 0; k < j.at.count; ++k) j.along[k] = wide(values.error[k].d);
  });
  const KrylovResult result = solve_tangent(load, sweeps, found);
  for (size_t b = 0; b < row_.size(); ++b) {
    if (row_[b] < 0) continue;
    float d[6];
    for (size_t k = 0; k < 6; ++k) d[k] = static_cast<float>(found[index(row_[b])][k]);
    t.motion[b] = {{d[0], d[1], d[2]}, {d[3], d[4], d[5]}};
  }
  put_results(t, q_out, qd_out);
  return result;
}

void BodiesAdjoint::put_results(const Tangents& t, float* q_out, float* qd_out) const {
  using namespace math;
  for (size_t b = 0; b < row_.size(); ++b) {
    const VbdBodyMotion& motion = step_.solution.motion[b];
    const Quatf start = step_.in.body_q.data()[b].q, after = unit(multiply(motion.turned, start));
    const Vec3f& com = step_.model.body_com.data()[b];
    const Vec3f turn = t.motion[b].angular + rotate(motion.turned, t.turned[b]);
    const Vec3f p = t.moved[b] + cross(t.turned[b], rotate(start, com)) + t.motion[b].linear -
                    cross(turn, rotate(after, com));
    const Quatf q = change_of(after, turn);
    const float pose[7] = {p.x, p.y, p.z, q.x, q.y, q.z, q.w};
    SpatialVectorf rate = t.qd[b];
    if (row_[b] >= 0)
      rate = SpatialVectorf{t.motion[b].linear,
                            inverse_left_jacobian_transposed(motion.turned, -motion.turn,
                                                             t.motion[b].angular)} *
             (1.0f / step_.dt);
    const float rates[6] = {rate.linear.x,  rate.linear.y,  rate.linear.z,
                            rate.angular.x, rate.angular.y, rate.angular.z};
    std::copy_n(pose, 7, q_out + 7 * b);
    std::copy_n(rates, 6, qd_out + 6 * b);
  }
}

}  // namespace novaphy::vbd
