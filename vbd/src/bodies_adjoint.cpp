#include "bodies_adjoint.h"

#include <algorithm>
#include <cmath>

namespace novaphy::vbd {
namespace {

// The penalty of a hard row in the matrix, over the penalty of the step's iterations. The method of
// multipliers then needs few solutions.
constexpr double kStiffer = 10.0;

double wide(float v) { return static_cast<double>(v); }

JointStart<DualFloat> dual(const JointStart<float>& s) {
  JointStart<DualFloat> to;
  to.kind = s.kind;
  for (int k = 0; k < 2; ++k) {
    to.side[k] = {vbd::dual(s.side[k].pose), vbd::dual(s.side[k].com), vbd::dual(s.side[k].qd)};
    to.frame[k] = vbd::dual(s.frame[k]);
  }
  to.axis = vbd::dual(s.axis);
  const JointAxis<float>& a = s.of_axis;
  using D = DualFloat;
  to.of_axis = {D(a.force),    D(a.ke),       D(a.kd),       D(a.target), D(a.target_rate),
                D(a.effort),   D(a.damping),  D(a.armature), D(a.friction), D(a.low),
                D(a.high),     D(a.limit_ke), D(a.limit_kd)};
  for (int k = 0; k < 6; ++k) {
    to.rod_ke[k] = D(s.rod_ke[k]);
    to.rod_kd[k] = D(s.rod_kd[k]);
  }
  return to;
}

void put_wrench(const SpatialVector<DualFloat>& f, double* to) {
  const DualFloat* const of[6] = {&f.linear.x,  &f.linear.y,  &f.linear.z,
                                  &f.angular.x, &f.angular.y, &f.angular.z};
  for (int r = 0; r < 6; ++r) to[r] = wide(of[r]->d);
}

// Sets the tangent of a motion: a displacement (k < 3) or a rotation.
void move_along(DualMotion& m, int k) {
  if (k < 3) {
    part(m.moved, k).d = 1.0f;
  } else {
    turn_about(m.turned, k - 3);
  }
}

}  // namespace

BodiesAdjoint::BodiesAdjoint(const SolvedBodies& step) : step_(step) {
  const size_t bodies = step.solution.motion.size();
  row_.assign(bodies, -1);
  int32_t rows = 0;
  for (size_t b = 0; b < bodies; ++b)
    if (step.solution.is_kinematic[b] == 0) row_[b] = rows++;
  system_.emplace(index(rows));
  for (int32_t b = 0; b < static_cast<int32_t>(bodies); ++b) {
    if (!moves(b)) continue;
    Block6& block = system_->at(row(b), row(b));
    const DualBody at = body_at(b);
    for (int c = 0; c < 6; ++c) {
      DualBody along = at;
      move_along(along.motion, c);
      put_wrench(force_on(along, step_.dt), block[static_cast<size_t>(c)].data());
    }
  }
  for (size_t k = 0; k < step.solution.joint.size(); ++k) {
    joint_.push_back(joint_at(k));
    put_derivatives(joint_.back(), *system_);
    put_coupling(joint_.back(), *system_);
  }
  system_->factor();
  load_.resize(bodies);
  mu_.resize(bodies);
}

DualBody BodiesAdjoint::body_at(int32_t body) const {
  const Model& m = step_.model;
  const auto b = index(body);
  const int32_t world = m.body_world.data()[b];
  DualBody to;
  to.start.q = vbd::dual(step_.in.body_q.data()[b].q);
  to.start.qd = vbd::dual(step_.in.body_qd.data()[b]);
  to.start.f = vbd::dual(step_.in.body_f.data()[b]);
  to.start.gravity = vbd::dual(m.gravity.data()[world < 0 ? m.world_count() - 1 : world]);
  to.start.mass = DualFloat(m.body_mass.data()[b]);
  to.start.inv_mass = DualFloat(m.body_inv_mass.data()[b]);
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      to.start.inertia.m[i][k] = DualFloat(m.body_inertia.data()[b].m[i][k]);
  to.motion = vbd::dual(step_.solution.motion[b]);
  return to;
}

BodiesAdjoint::Joint BodiesAdjoint::joint_at(size_t k) const {
  const VbdBodyJoint& j = step_.solution.joint[k];
  Joint to;
  to.index = index(step_.solution.joints[k]);
  const JointStart<float> start =
      joint_start(step_.model, step_.in.body_q.data(), step_.in.body_qd.data(), step_.control,
                  to.index);
  to.at.start = dual(start);
  VbdBodyMotion motion[2];
  for (int s = 0; s < 2; ++s) {
    to.body[s] = j.body[s];
    motion[s] = motion_of(step_.solution.motion.data(), j.body[s]);
    to.at.motion[s] = vbd::dual(motion[s]);
  }
  if (has_coordinate(j.kind))
    to.at.whole_turns = j.coordinate - joint_coordinate(joint_geometry(start));
  add_rows(j, joint_errors(j, motion[0], motion[1]), to);
  return to;
}

// Finds the rows that act, and their multipliers.
void BodiesAdjoint::add_rows(const VbdBodyJoint& j, const JointErrors& e, Joint& to) {
  const auto add = [&](RowKind kind, int r, float lam, float stiffness, float rho) {
    const int k = to.at.count++;
    to.at.rows[k] = {kind, r};
    to.at.lam[k] = DualFloat(lam);
    to.compliance[k] = 1.0 / wide(stiffness);
    to.penalty[k] = kStiffer * wide(rho);
  };
  for (int r = 0; r < point_rows(j.kind); ++r)
    if (const VbdJointRow& row = j.points[r]; row.stiffness != 0.0f)
      add(RowKind::Point, r, row_force(row, e.along.t[r], e.point, j.lam), row.stiffness, row.rho);
  for (int r = 0; r < turn_rows(j.kind); ++r)
    if (const VbdJointRow& row = j.turns[r]; row.stiffness != 0.0f)
      add(RowKind::Turn, r, row_force(row, e.along.t[r], e.turn, j.lam_turn), row.stiffness,
          row.rho);
  for (int r = 0; r < kVbdAxisRows; ++r) {
    const VbdAxisRow& row = j.rows[r];
    if (row.stiffness == 0.0f) continue;
    const float lam = softness(row) * (row.rho * (row.rest - e.coordinate) + row.lam);
    if (lam > row.lower && lam < row.upper) {
      add(RowKind::Axis, r, lam, row.stiffness, row.rho);
    } else {
      to.at.at_bound[r] = lam >= row.upper ? 1 : -1;
    }
  }
}

// Computes the derivatives of a joint. The derivatives of its forces with respect to the motion go
// to the system, transposed.
void BodiesAdjoint::put_derivatives(Joint& j, BlockSystem& system) const {
  for (int k = 0; k < j.at.count; ++k) {
    DualJoint at = j.at;
    at.lam[k].d = 1.0f;
    const DualJointValues values = values_of(at, step_.dt);
    for (int s = 0; s < 2; ++s) put_wrench(values.on[s], j.by_lam[k] + 6 * s);
  }
  for (int side = 0; side < 2; ++side) {
    if (j.body[side] < 0) continue;
    for (int c = 0; c < 6; ++c) {
      DualJoint at = j.at;
      move_along(at.motion[side], c);
      const DualJointValues values = values_of(at, step_.dt);
      for (int k = 0; k < j.at.count; ++k) j.by_motion[k][6 * side + c] = wide(values.error[k].d);
      for (int s = 0; s < 2; ++s) {
        if (!moves(j.body[s]) || !moves(j.body[side])) continue;
        double force[6];
        put_wrench(values.on[s], force);
        Row6& to = system.at(row(j.body[side]), row(j.body[s]))[static_cast<size_t>(c)];
        for (size_t r = 0; r < 6; ++r) to[r] += force[r];
      }
    }
  }
}

// Eliminates the rows of a joint: adds the transpose of by_lam stiffness by_motion to the system.
void BodiesAdjoint::put_coupling(const Joint& j, BlockSystem& system) const {
  for (int from = 0; from < 2; ++from)
    for (int to = 0; to < 2; ++to) {
      if (!moves(j.body[from]) || !moves(j.body[to])) continue;
      Block6& block = system.at(row(j.body[from]), row(j.body[to]));
      for (int k = 0; k < j.at.count; ++k)
        for (size_t c = 0; c < 6; ++c)
          for (size_t r = 0; r < 6; ++r)
            block[c][r] += j.stiffness(k) * (j.by_motion[k][6 * static_cast<size_t>(from) + c] *
                                             j.by_lam[k][6 * static_cast<size_t>(to) + r]);
    }
}

// Solves for the adjoints of the forces and of the rows, by the method of multipliers. The residual
// is the relative change of nu in the last sweep.
KrylovResult BodiesAdjoint::solve(int32_t sweeps) {
  constexpr double kSolved = 1e-8, kStalled = 1e-5;
  KrylovResult result;
  std::vector<Row6> rows;
  while (result.iterations < sweeps) {
    rows.clear();
    for (size_t b = 0; b < load_.size(); ++b)
      if (row_[b] >= 0) rows.push_back(load_[b]);
    for (const Joint& j : joint_)
      for (int s = 0; s < 2; ++s)
        for (int k = 0; k < j.at.count && moves(j.body[s]); ++k)
          for (size_t c = 0; c < 6; ++c)
            rows[row(j.body[s])][c] -= j.by_motion[k][6 * static_cast<size_t>(s) + c] *
                                       (j.stiffness(k) / j.penalty[k] * j.nu[k]);
    system_->solve(rows);
    double change = 0.0, size = 0.0;
    for (Joint& j : joint_)
      for (int k = 0; k < j.at.count; ++k) {
        double sum = j.nu[k] / j.penalty[k];
        for (int s = 0; s < 2; ++s)
          for (size_t r = 0; r < 6 && moves(j.body[s]); ++r)
            sum += j.by_lam[k][6 * static_cast<size_t>(s) + r] * rows[row(j.body[s])][r];
        const double nu = j.stiffness(k) * sum;
        change += (nu - j.nu[k]) * (nu - j.nu[k]);
        size += nu * nu;
        j.nu[k] = nu;
      }
    ++result.iterations;
    const double before = result.residual;
    result.residual = size > 0.0 ? std::sqrt(change / size) : 0.0;
    if (result.residual <= kSolved) break;
    // Rounding lets the residual fall no further.
    if (result.residual <= kStalled && result.residual > 0.5 * before) break;
  }
  for (size_t b = 0; b < mu_.size(); ++b)
    if (row_[b] >= 0) mu_[b] = rows[index(row_[b])];
  return result;
}

}  // namespace novaphy::vbd
