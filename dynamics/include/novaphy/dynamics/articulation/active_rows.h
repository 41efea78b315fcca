// The active constraint rows of converged contacts, for derivatives, and the distance of a step
// from other branches. A branch says which contacts push, stick or slide. Freestanding: shared by
// host and device kernels.
//
// Linear systems of contacts are solved in double precision. The contacts of a face depend on each
// other, so 1e-5 of the diagonal is added as regularization. Rows have the rounding of float32,
// 6e-8, and less regularization amplifies that rounding along undetermined directions. Only
// products, sums and quotients are used, because they round the same on every device.
#pragma once

#include "novaphy/dynamics/articulation/contact_branches.h"
#include "novaphy/dynamics/articulation/islands.h"

namespace novaphy::articulation {

inline constexpr float kSlides = 1e-5f;      // relative: this close to the friction cone counts as
                                             // sliding
inline constexpr double kRegularity = 1e-5;  // regularization of redundant rows, relative to their
                                             // diagonal
inline constexpr float kLeastSlip = 1e-6f;   // m/s: slower dofs and contacts do not slip
inline constexpr float kConverged = 1e-5f;   // m/s, convergence of shifts (pgs.h)

inline float tangent_length(float x, float y) { return math::sqrt(x * x + y * y); }

struct ContactBranch {
  bool active = false;
  bool slides[2] = {false, false};  // by tangent direction; both are equal with a friction cone
};
inline ContactBranch branch_of(const PgsContact<float>& c, bool cone) {
  ContactBranch b;
  b.active = c.impulse[0] > 0.0f;
  const float limit = c.friction * c.impulse[0] * (1.0f - kSlides);
  if (cone) {
    b.slides[0] = b.slides[1] = tangent_length(c.impulse[1], c.impulse[2]) >= limit;
  } else {
    for (int r = 0; r < 2; ++r) b.slides[r] = math::abs(c.impulse[r + 1]) >= limit;
  }
  return b;
}
// Returns whether a dof sticks by dry friction.
inline bool holds(float impulse, float limit) {
  return math::abs(impulse) < limit * (1.0f - kSlides);
}

// Computes the slip along the two tangents (m/s). Zeros if neither tangent slides.
inline void slip_along(const PgsContact<float>& c, const ContactBranch& branch, float* along) {
  const bool slides = branch.slides[0] || branch.slides[1];
  for (int i = 0; i < 2; ++i) along[i] = slides ? slip(c, i + 1) : 0.0f;
}

// The 3 x 3 blocks B and R of a contact (contact_adjoint.h). Rows are the equations of n, t1 and
// t2, columns are n, t1 and t2. `slip` {2}: slip along the tangents.
struct ContactBlocks {
  double b[3][3] = {}, r[3][3] = {};
};
inline void set_blocks(const PgsContact<float>& c, const ContactBranch& branch, bool cone,
                       const float* slip, ContactBlocks& k) {
  k = ContactBlocks{};
  k.b[0][0] = 1.0;
  k.r[0][0] = c.cfm;
  for (int i = 0; i < 2; ++i) {
    if (!branch.slides[i]) {
      k.b[i + 1][i + 1] = 1.0;
      continue;
    }
    k.r[i + 1][i + 1] = 1.0;
    if (!cone) k.r[i + 1][0] = (c.impulse[i + 1] < 0.0f ? 1.0 : -1.0) * c.friction;
  }
  if (!cone || !branch.slides[0]) return;
  const float length = tangent_length(slip[0], slip[1]);
  const double size = length > kLeastSlip ? length : kLeastSlip;
  const double by = tangent_length(c.impulse[1], c.impulse[2]);
  double t[2] = {slip[0] / size,
                 slip[1] / size};  // at convergence, t = -lambda_t / |lambda_t|
  if (by > 0.0)
    for (int i = 0; i < 2; ++i) t[i] = -c.impulse[i + 1] / by;
  const double push = double{c.friction} * c.impulse[0] / size;
  for (int i = 0; i < 2; ++i) {
    k.r[i + 1][0] = c.friction * t[i];
    for (int j = 0; j < 2; ++j) k.b[i + 1][j + 1] = push * ((i == j ? 1.0 : 0.0) - t[i] * t[j]);
  }
}
// Returns the derivative of the tangential rows by the friction coefficient: for a sliding tangent,
// the impulse along n times the direction of the slip.
inline void rows_by_friction(const PgsContact<float>& c, const ContactBranch& branch, bool cone,
                             const float* slip, double* to) {
  float direction[2] = {-c.impulse[1], -c.impulse[2]};
  if (c.impulse[1] == 0.0f && c.impulse[2] == 0.0f)
    for (int i = 0; i < 2; ++i) direction[i] = slip[i];
  const double size = tangent_length(direction[0], direction[1]);
  for (int i = 0; i < 2; ++i) {
    to[i] = 0.0;
    if (!branch.slides[i] || direction[i] == 0.0f) continue;
    const double along = cone ? direction[i] / size : (direction[i] < 0.0f ? -1.0 : 1.0);
    to[i] = c.impulse[0] * along;
  }
}

// Solves A x = b by Gaussian elimination with row pivoting. a {n, n + 1}: A with b as the last
// column, which x replaces.
inline void solve_dense(double* a, int64_t n) {
  const int64_t width = n + 1;
  const auto size = [](double x) { return x < 0.0 ? -x : x; };
  for (int64_t k = 0; k < n; ++k) {
    int64_t best = k;
    for (int64_t i = k + 1; i < n; ++i)
      if (size(a[i * width + k]) > size(a[best * width + k])) best = i;
    if (a[best * width + k] == 0.0) continue;
    for (int64_t j = 0; best != k && j < width; ++j) {
      const double x = a[k * width + j];
      a[k * width + j] = a[best * width + j];
      a[best * width + j] = x;
    }
    for (int64_t i = k + 1; i < n; ++i) {
      const double f = a[i * width + k] / a[k * width + k];
      if (f == 0.0) continue;
      for (int64_t j = k; j < width; ++j) a[i * width + j] -= f * a[k * width + j];
    }
  }
  for (int64_t k = n; k-- > 0;) {
    double x = a[k * width + n];
    for (int64_t j = k + 1; j < n; ++j) x -= a[k * width + j] * a[j * width + n];
    a[k * width + n] = a[k * width + k] == 0.0 ? 0.0 : x / a[k * width + k];
  }
}

// Returns the coupling of two contact rows: J_i of contact a times Y_j of contact b.
inline double coupling(const PgsContact<float>& a, int i, const PgsContact<float>& b, int j) {
  double sum = 0.0;
  for (const RowSide<float>& s : a.sides)
    for (const RowSide<float>& t : b.sides)
      if (t.response != nullptr && s.rates == t.rates)
        sum += row_dot(s.jacobian + i * s.width, t.response + j * t.width, s.width);
  return sum;
}

// Counts and margins of the branches of a step, or of a part of it, for ContactBranches. `held`:
// contacts with a frozen point or normal.
struct BranchNotes {
  int32_t rows = 0, held = 0, breaking = 0, sticking = 0, sliding = 0;
  int32_t far = 0;  // whether an island is far from convergence
  float normal_margin = ContactBranches::kNone, gap_margin = ContactBranches::kNone,
        cone_margin = ContactBranches::kNone, slip_margin = ContactBranches::kNone;
  StepNotes all;
};
inline void lower(float& to, float value) { to = value < to ? value : to; }
inline void raise(float& to, float value) { to = to < value ? value : to; }
inline void note_all(const BranchNotes& of, BranchNotes& to) {
  to.rows += of.rows;
  if (of.far != 0) to.far = 1;
  to.held += of.held;
  to.breaking += of.breaking;
  to.sticking += of.sticking;
  to.sliding += of.sliding;
  lower(to.normal_margin, of.normal_margin);
  lower(to.gap_margin, of.gap_margin);
  lower(to.cone_margin, of.cone_margin);
  lower(to.slip_margin, of.slip_margin);
  note_all(of.all, to.all);
}
// Adds the counts and margins of a whole step.
inline void note_step(const BranchNotes& of, ContactBranches& to) {
  note_step(of.all, to.all);
  if (of.rows == 0) return;
  ++to.steps;
  to.unconverged += of.far;
  to.held += of.held;
  to.breaking += of.breaking;
  to.sticking += of.sticking;
  to.sliding += of.sliding;
  lower(to.normal_margin, of.normal_margin);
  lower(to.gap_margin, of.gap_margin);
  lower(to.cone_margin, of.cone_margin);
  lower(to.slip_margin, of.slip_margin);
}

// Returns the state of a contact, by which the next step detects events (gradient_counts.h).
inline SeenContact seen_contact(const ContactRows& c, const IslandContact& row, bool cone) {
  const ContactBranch branch = branch_of(row.solver, cone);
  const int32_t mode = 1 + (branch.slides[0] ? 1 : 0) + (branch.slides[1] ? 2 : 0);
  return {c.shape0[row.contact], c.shape1[row.contact],
          c.point_id == nullptr ? -1 : c.point_id[row.contact], branch.active ? mode : 0};
}

// Returns the residual of an island: the last change of velocity relative to the largest impulse,
// both from IslandResult. 0 if the sweeps met their tolerance.
inline float relative_residual(float residual, float largest, float tolerance) {
  return residual < tolerance ? 0.0f : residual / largest;
}

// Adds a contact to the counts. `by_restitution`: whether gradients by restitution are requested.
// For an approach with restitution 0 the law jumps, so this gradient does not exist.
inline void note_contact(const ContactRows& of, const ContactLaw<float>& law, bool by_restitution,
                         const IslandContact& row, BranchNotes& to) {
  const PgsContact<float>& c = row.solver;
  // Whether the derivative of beta changes where the gap is 0, or where the overlap is the slop.
  const bool at_contact = law.compliant || law.slop > 0.0f || law.erp < 1.0f;
  const bool at_slop = !law.compliant && law.slop > 0.0f && law.erp > 0.0f;
  const ContactBranch branch = branch_of(c, law.cone);
  const bool jumps = !row.elastic && row.before < -law.restitution_threshold;
  // Whether the contact shifts, and whether its softness or its shift changes with q.
  const bool shifts = c.shifted > 0.0f;
  const bool softened = (branch.active && c.cfm > row.target.cfm) || (shifts && c.lack > 0.0f);
  const bool shifting =
      shifts && math::abs(moving_slip(c) + c.shift + c.softness * c.shifted) >= kConverged;
  if ((by_restitution && jumps) || softened || shifting) to.all.jumps |= kLawJumps;
  ++to.rows;
  const float normal = branch.active ? c.impulse[0] * c.normal : math::abs(slip(c, 0) + c.bias);
  lower(to.normal_margin, normal);
  if (!row.follows && !row.turns && (branch.active || shifts)) {
    ++to.held;
    take_first({of.shape0[row.contact], of.shape1[row.contact], 0}, to.all.held);
  }
  if (branch.active) {
    const bool slides = branch.slides[0] || branch.slides[1];
    ++(slides ? to.sliding : to.sticking);
    float gap = ContactBranches::kNone;
    if (at_contact) gap = math::abs(row.place.gap);
    if (at_slop) lower(gap, math::abs(row.place.gap + law.slop));
    lower(to.gap_margin, gap);
    const float limit = c.friction * c.impulse[0];
    const float t1 = math::abs(c.impulse[1]), t2 = math::abs(c.impulse[2]);
    const float most = law.cone ? tangent_length(t1, t2) : (t1 < t2 ? t2 : t1);
    if (!(limit > 0.0f)) {  // no friction, no cone
    } else if (slides) {
      lower(to.slip_margin, tangent_length(slip(c, 1), slip(c, 2)));
    } else {
      lower(to.cone_margin, 1.0f - most / limit);
    }
  } else {
    ++to.breaking;
  }
}
inline void note_friction(const PgsJointFriction<float>& f, BranchNotes& to) {
  ++to.rows;
  if (holds(f.impulse, f.limit))
    lower(to.cone_margin, 1.0f - math::abs(f.impulse) / f.limit);
  else
    lower(to.slip_margin, math::abs(f.rates[f.dof]));
}

}  // namespace novaphy::articulation
