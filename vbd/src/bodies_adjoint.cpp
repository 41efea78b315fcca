#include "bodies_adjoint.h"

#include <algorithm>
#include <cmath>

namespace novaphy::vbd {
namespace {

// The penalty of a hard row in the matrix, over the penalty of the step's iterations. The method of
// multipliers then needs few solutions.
constexpr double kStiffer = 1e4;

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

ContactStart<DualFloat> dual(const ContactStart<float>& s) {
  ContactStart<DualFloat> to;
  for (int k = 0; k < 2; ++k) {
    to.pose[k] = vbd::dual(s.pose[k]);
    to.com[k] = vbd::dual(s.com[k]);
    to.point[k] = vbd::dual(s.point[k]);
    to.margin[k] = DualFloat(s.margin[k]);
  }
  to.normal = vbd::dual(s.normal);
  to.stiffness = DualFloat(s.stiffness);
  to.damping = DualFloat(s.damping);
  to.mu = DualFloat(s.mu);
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
  for (size_t b = 0; b < bodies; ++b)
    if (step.solution.is_kinematic[b] == 0) row_[b] = rows_++;
  system_.emplace(index(rows_));
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
  for (size_t k = 0; k < step.solution.joint.size(); ++k) joint_.push_back(joint_at(k));
  for (size_t k = 0; k < step.solution.contact.size(); ++k) add_touch(k);
  for_pairs([this](auto& pair) {
    put_derivatives(pair, *system_);
    put_coupling(pair, *system_);
  });
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

template <class At>
void BodiesAdjoint::Pair<At>::add(float multiplier, double compliance_of_row, float rho) {
  const int k = at.count++;
  at.lam[k] = DualFloat(multiplier);
  compliance[k] = compliance_of_row;
  penalty[k] = kStiffer * wide(rho);
}

// Adds a contact, if it pushes.
void BodiesAdjoint::add_touch(size_t k) {
  const VbdBodyContact& c = step_.solution.contact[k];
  const VbdBodyMotion a = motion_of(step_.solution.motion.data(), c.body[0]);
  const VbdBodyMotion b = motion_of(step_.solution.motion.data(), c.body[1]);
  const ContactForce f = contact_force(c, a, b, 1.0f);
  if (!(f.normal > 0.0f)) return;
  Touch to;
  to.index = k;
  const ContactOrigin& origin = step_.solution.contact_origin[k];
  to.at.start = dual(origin.start);
  to.at.ignored = c.ignored;
  for (int s = 0; s < 2; ++s) {
    to.body[s] = c.body[s];
    to.at.motion[s] = vbd::dual(s == 0 ? a : b);
    to.at.is_plane[s] =
        step_.solution.contacts_follow && is_world_plane(step_.model, origin.shape[s]);
  }
  const float depth = contact_depth(c, a, b);
  to.add(f.normal - contact_damping(c, depth) * (depth + c.gap), 1.0 / wide(c.stiffness), c.rho);
  const Vec3f slip = contact_slip(c, a, b), wanted = c.lam_t - slip * c.rho_t;
  const float cone = c.mu * f.normal, size = math::length(wanted);
  if (size > cone) {
    to.at.slides = wanted * (1.0f / size);
    to.at.least_slip = cone / c.rho_t;
  } else if (cone > 0.0f) {
    const Perpendicular across = perpendicular(c.normal);
    for (int r = 0; r < 2; ++r) to.add(math::dot(wanted, across.t[r]), 0.0, c.rho_t);
  }
  touch_.push_back(to);
}

// Finds the rows that act, and their multipliers.
void BodiesAdjoint::add_rows(const VbdBodyJoint& j, const JointErrors& e, Joint& to) {
  const auto add = [&](RowKind kind, int r, float lam, float stiffness, float rho) {
    to.at.rows[to.at.count] = {kind, r};
    to.add(lam, 1.0 / wide(stiffness), rho);
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

// Computes the derivatives of a joint or contact. The derivatives of its forces with respect to the motion go
// to the system, transposed.
template <class At>
void BodiesAdjoint::put_derivatives(Pair<At>& j, BlockSystem& system) const {
  for (int k = 0; k < j.at.count; ++k) {
    At at = j.at;
    at.lam[k].d = 1.0f;
    const DualValues values = values_of(at, step_.dt);
    for (int s = 0; s < 2; ++s) put_wrench(values.on[s], j.by_lam[k] + 6 * s);
  }
  for (int side = 0; side < 2; ++side) {
    if (j.body[side] < 0) continue;
    for (int c = 0; c < 6; ++c) {
      At at = j.at;
      move_along(at.motion[side], c);
      const DualValues values = values_of(at, step_.dt);
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

// Eliminates the rows of a joint or contact: adds the transpose of by_lam stiffness by_motion to the system.
template <class At>
void BodiesAdjoint::put_coupling(const Pair<At>& j, BlockSystem& system) const {
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

// Returns the size of the change over the largest size of all sweeps. The solution is 0 for bodies
// that cannot move.
double BodiesAdjoint::relative_change(const std::vector<Row6>& before,
                                      const std::vector<Row6>& after) {
  double change = 0.0, size = 0.0;
  for (size_t b = 0; b < row_.size(); ++b) {
    if (row_[b] < 0) continue;
    const float* const inertia = &step_.model.body_inertia.data()[b].m[0][0];
    const double mass = wide(step_.model.body_mass.data()[b]);
    const double turning = (wide(inertia[0]) + wide(inertia[4]) + wide(inertia[8])) / 3.0;
    for (size_t k = 0; k < 6; ++k) {
      const double a = before[index(row_[b])][k], c = after[index(row_[b])][k];
      change += (k < 3 ? mass : turning) * (c - a) * (c - a);
      size += (k < 3 ? mass : turning) * c * c;
    }
  }
  largest_ = std::max(largest_, size);
  return largest_ > 0.0 ? std::sqrt(change / largest_) : 0.0;
}

// Counts a sweep. Returns whether the sweeps can end.
bool BodiesAdjoint::is_solved(const std::vector<Row6>& before, const std::vector<Row6>& after,
                              KrylovResult& result) {
  constexpr double kSolved = 1e-8, kStalled = 1e-7;
  const double last = result.residual;
  ++result.iterations;
  result.residual = relative_change(before, after);
  if (result.residual <= kSolved) return true;
  // Rounding lets the residual fall no further.
  return result.residual <= kStalled && result.residual > 0.5 * last;
}

// Solves for the adjoints of the forces and of the rows, by the method of multipliers. The residual
// is the relative change of mu in the last sweep, weighted by masses and mean inertias.
// The adjoints nu of rows that depend on each other are not unique.
KrylovResult BodiesAdjoint::solve(int32_t sweeps) {
  KrylovResult result;
  largest_ = 0.0;
  std::vector<Row6> rows, before(index(rows_));
  while (result.iterations < sweeps) {
    rows.clear();
    for (size_t b = 0; b < load_.size(); ++b)
      if (row_[b] >= 0) rows.push_back(load_[b]);
    for_pairs([&](const auto& j) {
      for (int s = 0; s < 2; ++s)
        for (int k = 0; k < j.at.count && moves(j.body[s]); ++k)
          for (size_t c = 0; c < 6; ++c)
            rows[row(j.body[s])][c] -= j.by_motion[k][6 * static_cast<size_t>(s) + c] *
                                       (j.stiffness(k) / j.penalty[k] * j.nu[k]);
    });
    system_->solve(rows);
    for_pairs([&](auto& j) {
      for (int k = 0; k < j.at.count; ++k) {
        double sum = j.nu[k] / j.penalty[k];
        for (int s = 0; s < 2; ++s)
          for (size_t r = 0; r < 6 && moves(j.body[s]); ++r)
            sum += j.by_lam[k][6 * static_cast<size_t>(s) + r] * rows[row(j.body[s])][r];
        j.nu[k] = j.stiffness(k) * sum;
      }
    });
    if (is_solved(before, rows, result)) break;
    before = rows;
  }
  for (size_t b = 0; b < mu_.size(); ++b)
    if (row_[b] >= 0) mu_[b] = rows[index(row_[b])];
  return result;
}

}  // namespace novaphy::vbd
