// The rows of converged contacts that are active, as derivatives take them, and how near a step is
// to other ones. Freestanding: the host and the kernels of devices share it.
//
// Systems are solved in double precision: contacts of a face depend on each other, and what keeps
// them apart is 1e-7 of the diagonal. Products, sums and quotients only, which round everywhere
// alike.
#pragma once

#include "novaphy/dynamics/articulation/contact_branches.h"
#include "novaphy/dynamics/articulation/islands.h"

namespace novaphy::articulation {

inline constexpr float kSlides = 1e-5f;        // relative: nearer to the cone is on it
inline constexpr double kRegularity = 1e-7;    // of redundant rows, relative to their diagonal
inline constexpr float kLeastSlip = 1e-6f;     // m/s
inline constexpr float kSameFriction = 1e-4f;  // 1
inline constexpr double kDependent = 1e-5;     // of a normal that others make up, relative
inline constexpr float kConverged = 1e-5f;     // m/s
inline constexpr float kNearNormal = 1e-5f;    // m/s
inline constexpr float kNearGap = 1e-6f;       // m
inline constexpr float kNearCone = 1e-3f;      // 1

inline float tangent_length(float x, float y) { return math::sqrt(x * x + y * y); }

struct ContactBranch {
  bool active = false;
  bool slides[2] = {false, false};  // of the tangents; of a cone both or none
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
// Whether dry friction holds its dof.
inline bool holds(float impulse, float limit) {
  return math::abs(impulse) < limit * (1.0f - kSlides);
}

// The slip along the tangents, where one of them slides; else zeros.
inline void slip_along(const PgsContact<float>& c, const ContactBranch& branch, float* along) {
  const bool slides = branch.slides[0] || branch.slides[1];
  for (int i = 0; i < 2; ++i) along[i] = slides ? slip(c, i + 1) : 0.0f;
}

// B and R of a contact; rows are equations, columns n, t1, t2. `slip` {2}: along the tangents.
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
                 slip[1] / size};  // a converged sweep has t = -lambda_t / |lambda_t|
  if (by > 0.0)
    for (int i = 0; i < 2; ++i) t[i] = -c.impulse[i + 1] / by;
  const double push = double{c.friction} * c.impulse[0] / size;
  for (int i = 0; i < 2; ++i) {
    k.r[i + 1][0] = c.friction * t[i];
    for (int j = 0; j < 2; ++j) k.b[i + 1][j + 1] = push * ((i == j ? 1.0 : 0.0) - t[i] * t[j]);
  }
}
// How the rows change with the friction coefficient: where a tangent slides, the impulse along n
// times the direction of its slip.
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

// x of A x = b for A {n, n + 1} with b as the last column, which x replaces. By rows, with pivots.
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

// What the rows of two contacts share: J_i of a times Y_j of b.
inline double coupling(const PgsContact<float>& a, int i, const PgsContact<float>& b, int j) {
  double sum = 0.0;
  for (const RowSide<float>& s : a.sides)
    for (const RowSide<float>& t : b.sides)
      if (t.response != nullptr && s.rates == t.rates)
        sum += row_dot(s.jacobian + i * s.width, t.response + j * t.width, s.width);
  return sum;
}

// What branches the rows of a step have, or of a part of one: ContactBranches of it.
struct BranchNotes {
  int32_t rows = 0, exact = 1;  // 0: a branch is too near; without regard to `held`
  int32_t far = 0;              // an island is far from converged
  int32_t held = 0, breaking = 0, sticking = 0, sliding = 0;
  float normal_margin = ContactBranches::kNone, gap_margin = ContactBranches::kNone,
        cone_margin = ContactBranches::kNone, slip_margin = ContactBranches::kNone, residual = 0.0f;
};
inline void lower(float& to, float value) { to = value < to ? value : to; }
inline void raise(float& to, float value) { to = to < value ? value : to; }
inline void note_all(const BranchNotes& of, BranchNotes& to) {
  to.rows += of.rows;
  if (of.exact == 0) to.exact = 0;
  if (of.far != 0) to.far = 1;
  to.held += of.held;
  to.breaking += of.breaking;
  to.sticking += of.sticking;
  to.sliding += of.sliding;
  lower(to.normal_margin, of.normal_margin);
  lower(to.gap_margin, of.gap_margin);
  lower(to.cone_margin, of.cone_margin);
  lower(to.slip_margin, of.slip_margin);
  raise(to.residual, of.residual);
}
// Those of a whole step.
inline void note_step(const BranchNotes& of, ContactBranches& to) {
  if (of.rows == 0) return;
  ++to.steps;
  to.unconverged += of.far;
  to.held += of.held;
  if (of.exact != 0 && of.residual < kConverged) ++(of.held == 0 ? to.exact : to.frozen);
  to.breaking += of.breaking;
  to.sticking += of.sticking;
  to.sliding += of.sliding;
  lower(to.normal_margin, of.normal_margin);
  lower(to.gap_margin, of.gap_margin);
  lower(to.cone_margin, of.cone_margin);
  lower(to.slip_margin, of.slip_margin);
  raise(to.residual, of.residual);
}

// `by_restitution`: for gradients by it, which an approach without any has none of: its law jumps.
inline void note_contact(const ContactLaw<float>& law, bool by_restitution,
                         const IslandContact& row, BranchNotes& to) {
  const PgsContact<float>& c = row.solver;
  // Where beta has another slope on the other side.
  const bool at_contact = law.compliant || law.slop > 0.0f || law.erp < 1.0f;
  const bool at_slop = !law.compliant && law.slop > 0.0f && law.erp > 0.0f;
  const ContactBranch branch = branch_of(c, law.cone);
  const bool jumps = !row.elastic && row.before < -law.restitution_threshold;
  const bool softened = c.cfm > row.target.cfm;  // by a part of what changes with q
  bool exact = !(by_restitution && jumps) && !(branch.active && softened);
  ++to.rows;
  const float normal = branch.active ? c.impulse[0] * c.normal : math::abs(slip(c, 0) + c.bias);
  lower(to.normal_margin, normal);
  exact = exact && normal >= kNearNormal;
  const float moves = moving_slip(c), left = moves + c.shift + c.softness * c.shifted;
  const bool shifts = c.shifted > 0.0f;
  if (shifts || c.shift < c.bias || math::abs(moves - slip(c, 0)) > kNearNormal) {
    exact = exact && (shifts ? c.shifted * c.normal >= kNearNormal && math::abs(left) < kConverged
                             : left >= kNearNormal);
  }
  if (!row.follows && (branch.active || shifts)) ++to.held;
  if (branch.active) {
    const bool slides = branch.slides[0] || branch.slides[1];
    ++(slides ? to.sliding : to.sticking);
    float gap = ContactBranches::kNone;
    if (at_contact) gap = math::abs(row.place.gap);
    if (at_slop) lower(gap, math::abs(row.place.gap + law.slop));
    lower(to.gap_margin, gap);
    exact = exact && gap >= kNearGap;
    const float limit = c.friction * c.impulse[0];
    const float t1 = math::abs(c.impulse[1]), t2 = math::abs(c.impulse[2]);
    const float most = law.cone ? tangent_length(t1, t2) : (t1 < t2 ? t2 : t1);
    if (!(limit > 0.0f)) {  // without friction there is no cone
    } else if (slides) {
      const float along = tangent_length(slip(c, 1), slip(c, 2));
      lower(to.slip_margin, along);
      exact = exact && along >= kNearNormal;
    } else {
      lower(to.cone_margin, 1.0f - most / limit);
      exact = exact && 1.0f - most / limit >= kNearCone;
    }
  } else {
    ++to.breaking;
  }
  if (!exact) to.exact = 0;
}
inline void note_friction(const PgsJointFriction<float>& f, BranchNotes& to) {
  ++to.rows;
  bool exact = true;
  if (holds(f.impulse, f.limit)) {
    const float margin = 1.0f - math::abs(f.impulse) / f.limit;
    lower(to.cone_margin, margin);
    exact = margin >= kNearCone;
  } else {
    const float rate = math::abs(f.rates[f.dof]);
    lower(to.slip_margin, rate);
    exact = rate >= kNearNormal;
  }
  if (!exact) to.exact = 0;
}

// Whether the result depends on how the sweeps shared the force among normals that depend on each
// other, as those of a box's face do: where contacts slide, and the friction for a unit of normal
// force is not the same for all of them. The adjoint shares in its own way. `contact_of` gives the
// n contacts of an island; `system` holds `most` numbers, and where they are too few the answer is
// yes: a i (i + 1) / 2 are needed for i normals.
template <class ContactOf>
bool sharing_matters(int32_t n, const ContactOf& contact_of, bool cone, double* system,
                     int64_t most) {
  bool slides = false, same = true;
  Vec3f first{};
  int32_t listed = 0;
  for (int32_t i = 0; i < n; ++i) {
    const IslandContact& row = contact_of(i);
    const PgsContact<float>& c = row.solver;
    if (c.impulse[0] <= 0.0f || c.cfm > 0.0f) continue;
    const ContactBranch branch = branch_of(c, cone);
    slides = slides || (c.friction > 0.0f && (branch.slides[0] || branch.slides[1]));
    const Vec3f friction = (row.frame.axes[1] * c.impulse[1] + row.frame.axes[2] * c.impulse[2]) *
                           (1.0f / c.impulse[0]);
    if (listed == 0) first = friction;
    const Vec3f other = friction - first;
    same = same && math::dot(other, other) <= kSameFriction * kSameFriction;
    contact_of(listed++).listed = i;
  }
  if (!slides || same) return false;
  // A factor L D L^T of the normals' part of the system loses a pivot where they depend.
  if (int64_t{listed} * (listed + 1) / 2 > most) return true;
  const auto at = [](int64_t i, int64_t j) { return i * (i + 1) / 2 + j; };
  const auto normal_of = [&](int32_t i) -> const PgsContact<float>& {
    return contact_of(contact_of(i).listed).solver;
  };
  for (int32_t i = 0; i < listed; ++i)
    for (int32_t j = 0; j <= i; ++j) {
      double left = coupling(normal_of(i), 0, normal_of(j), 0);
      const double whole = left;
      for (int32_t k = 0; k < j; ++k)
        left -= system[at(i, k)] * system[at(j, k)] * system[at(k, k)];
      if (i == j && left <= kDependent * whole) return true;
      system[at(i, j)] = i == j ? left : left / system[at(j, j)];
    }
  return false;
}

}  // namespace novaphy::articulation
