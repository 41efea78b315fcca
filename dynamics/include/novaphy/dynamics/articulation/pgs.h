// Contacts and dry friction of joints by projected Gauss-Seidel, at the velocity level.
//
//   v' = v + M^-1 J^T lambda,  lambda: impulses (N s), v: rates of the step without impulses
//   normal     0 <= lambda_n, J_n v' + beta + cfm lambda_n >= 0, at least one of them 0
//   friction   |lambda_t| <= mu lambda_n, against the slip J_t v' (cone); or each of the two
//              tangents by itself (pyramid: up to sqrt 2 too strong along the diagonals)
//   joints     |lambda| <= friction dt, against the rate of the dof
// beta depends on the gap d:
//   d > 0      beta = d / dt: the gap may close, but not more
//   d <= 0     beta = erp min(0, d + slop) / dt, at least -max_depenetration: the correction of an
//              overlap. Rates get the part of it (without the slop) that fits into kRestSpeed, so
//              resting contacts are at d = 0 up to rounding. The remaining correction is a shift:
//              it moves positions without changing rates
//   an approach faster than the restitution threshold that touches within the step:
//              beta = min(beta, restitution J_n qd), qd: the rates before the step
// A contact with stiffness k and damping c instead has, for d <= 0,
//   beta = erp d / dt, erp = dt k / (dt k + c), and cfm = 1 / (dt (dt k + c)).
//
// A sweep processes the contacts one by one: the normal first, then the tangents as a block. With Y
// = M^-1 J^T, s is the largest eigenvalue of the tangents' 2 x 2 block of J Y. Tangential impulses
// change by -J_t v' / s and are projected radially. Sliding does not lift a contact (no De Saxce
// correction). After some sweeps, normals include the effect of their friction (rubbing.h). Shifts
// p solve the same law for positions, which move at v' + p:
//   p = M^-1 J_n^T mu,  0 <= mu, J_n (v' + p) + beta + softness mu >= 0, at least one of them 0
// Contacts that the joints of a tree can hardly separate would need unbounded impulses. Two lower
// bounds prevent this. First, cfm increases the mobility of a normal to at least kLeastMobility of
// the J_n Y_n that its two sides have without coupling, and to at least kLeastOfMass / m. For
// shifts a normal has a softness of kShiftSoftness of the first bound plus kLeastOfMass / m.
//
// The mass m is that of all moving bodies in the trees of the contact. If a tree touches itself, m
// is the mass that joints can separate, on the lighter side. A tree that is not fixed to the world
// has a J_n Y_n of at least 1 / m against other trees.
//
// A joint cannot resolve an overlap deeper than its lever arm, so no contact shifts a dof by more
// than kMostShift. Shifts ignore a contact without an impulse that only a speed above kMoreSpeed
// would close in the step, because steps may leave it out.
// Sources: Guendelman, Bridson, Fedkiw, Nonconvex Rigid Bodies with Stacking (2003), section 7, for
// shifts. Preclik, Models and Algorithms for Ultrascale Simulations of Non-smooth Granular Dynamics
// (2014), section 4. Catto, Iterative Dynamics with Temporal Coherence (2005).
#pragma once

#include "novaphy/dynamics/articulation/scalar.h"

namespace novaphy::articulation {

template <class T>
struct ContactLaw {
  T dt{};                     // s
  T erp{}, slop{}, cfm{};     // 1, m, (m/s) / (N s)
  T max_depenetration{};      // m/s
  T restitution_threshold{};  // m/s
  bool compliant = false;     // uses the stiffness and damping of the shapes
  bool cone = true;
};
inline constexpr float kRestSpeed = 0.01f;       // m/s
inline constexpr float kMoreSpeed = 4.0f;        // m/s
inline constexpr float kLeastMobility = 1e-3f;   // 1
inline constexpr float kLeastOfMass = 1e-2f;     // 1
inline constexpr float kShiftSoftness = 0.05f;   // 1
inline constexpr float kMostShift = 0.1f;        // rad or m per dof and step
inline constexpr int32_t kShiftSweeps = 100;     // largest number of sweeps of shifts
inline constexpr float kShiftTolerance = 1e-6f;  // m/s
inline constexpr float kOtherAxes = 1e-3f;       // 1: fraction of the J Y of all three rows that
                                                 // is added to the J_n Y_n of the sides alone
template <class T>
struct ContactMaterial {
  T friction{}, restitution{}, stiffness{}, damping{};
};

// beta of a normal row: `bias` for rates, `shift` for positions. `slope` and `shift_slope`: their
// derivatives by the gap in the active branch. `bounce`, `shift_bounce`: those by J_n qd.
template <class T>
struct NormalTarget {
  T bias{}, cfm{}, slope{}, bounce{}, shift{}, shift_slope{}, shift_bounce{};
};
// Returns beta. `before`: J_n qd at the start of the step. `after`: J_n v without impulses.
template <class T>
NormalTarget<T> normal_target(const ContactLaw<T>& law, const ContactMaterial<T>& material,
                              const T& gap, const T& before, const T& after) {
  const T o = T(0.0f);
  NormalTarget<T> to{gap / law.dt, law.cfm, T(1.0f) / law.dt, o, o, o, o};
  const auto open = gap > o;
  if (law.compliant) {
    const T softness = law.dt * material.stiffness + material.damping;
    to.cfm = law.cfm + T(1.0f) / (law.dt * softness);
    to.slope = select(open, to.slope, material.stiffness / softness);
    to.bias = select(open, to.bias, to.slope * gap);
  } else {
    const T depth = gap + law.slop;
    to.slope = select(open, to.slope, select(depth > o, o, law.erp / law.dt));
    to.bias = select(open, to.bias, to.slope * depth);
  }
  const auto deep = to.bias < -law.max_depenetration;
  to.bias = select(deep, -law.max_depenetration, to.bias);
  to.slope = select(deep, o, to.slope);
  to.shift = to.bias;
  to.shift_slope = to.slope;
  if (!law.compliant) {
    const T left = T(kRestSpeed) - law.erp * law.slop / law.dt;
    const T least = select(left > o, -left, o);
    const auto overlaps = to.bias < least;
    to.bias = select(overlaps, least, to.bias);
    to.slope = select(overlaps, o, to.slope);
  }
  const auto bouncy = both(material.restitution > o, before < -law.restitution_threshold);
  if (!any(bouncy)) return to;
  const auto touches = gap + law.dt * select(after < before, after, before) < o;
  const T bounce = material.restitution * before;
  const auto bounces = both(both(touches, bouncy), bounce < to.bias);
  to.bias = select(bounces, bounce, to.bias);
  to.slope = select(bounces, o, to.slope);
  to.bounce = select(bounces, material.restitution, o);
  const auto ahead = to.bias < to.shift;
  to.shift = select(ahead, to.bias, to.shift);
  to.shift_slope = select(ahead, to.slope, to.shift_slope);
  to.shift_bounce = select(ahead, to.bounce, o);
  return to;
}

// A tree's part of a contact row: the tree's rates with the shifts p behind them, J and Y (null:
// the tree does not move). `width`: number of dofs, padded with zeros to a multiple of 4.
template <class T>
struct RowSide {
  T* rates = nullptr;  // {2 width}
  const T *jacobian = nullptr, *response = nullptr;
  int32_t width = 0;
};

// Four entries of a row, which the compiler processes as one SIMD vector.
template <class T>
struct Four {
  T v[4];
};
template <class T>
Four<T> four(const T* x) {
  return {{x[0], x[1], x[2], x[3]}};
}
// Returns to + x y, entry by entry.
template <class T>
Four<T> add_product(const Four<T>& to, const Four<T>& x, const Four<T>& y) {
  Four<T> sum = to;
  for (int32_t i = 0; i < 4; ++i) sum.v[i] = to.v[i] + x.v[i] * y.v[i];
  return sum;
}
// Returns the dot product a . b, summed in four partial sums. `width` may be any number.
template <class T>
T row_dot(const T* a, const T* b, int32_t width) {
  const T o = T(0.0f);
  Four<T> s = {{o, o, o, o}};
  for (int32_t k = 0; k < width; k += 4) s = add_product(s, four(a + k), four(b + k));
  return (s.v[0] + s.v[1]) + (s.v[2] + s.v[3]);
}
// Adds `impulse` times the response y to the rates.
template <class T>
void add_row(const T* y, const T& impulse, int32_t width, T* rates) {
  const Four<T> by = {{impulse, impulse, impulse, impulse}};
  for (int32_t k = 0; k < width; k += 4) {
    const Four<T> sum = add_product(four(rates + k), four(y + k), by);
    for (int32_t i = 0; i < 4; ++i) rates[k + i] = sum.v[i];
  }
}

// The data of a contact that a sweep uses.
template <class T>
struct PgsNumbers {
  T bias{}, shift{}, cfm{}, friction{};
  T normal{}, apart{};                       // J_n Y_n; the sum of both sides without their
                                             // coupling
  T mass{};                                  // m, kg
  T reach{};                                 // largest absolute entry of Y_n
  T tangent[3] = {};                         // t1 t1, t1 t2, t2 t2 of J Y
  T normal_step{}, bound{}, tangent_step{};  // 1 / (J_n Y_n + cfm), s, 1 / s
  T impulse[3] = {};                         // along n, t1, t2
  T softness{}, shifted{};                   // of shifts; `shifted` is mu
  T lack{};                                  // > 0: softness that enforces kMostShift
};
template <class T>
struct PgsContact : PgsNumbers<T> {
  RowSide<T> sides[2];  // three rows each; a missing side has width 0
};

template <class T>
T slip(const PgsContact<T>& c, int32_t row) {
  T v = T(0.0f);
  for (const RowSide<T>& s : c.sides)
    if (s.width > 0) v = v + row_dot(s.jacobian + row * s.width, s.rates, s.width);
  return v;
}
// Returns J_n (v' + p), the normal velocity with shifts.
template <class T>
T moving_slip(const PgsContact<T>& c) {
  T v = slip(c, 0);
  for (const RowSide<T>& s : c.sides)
    if (s.width > 0) v = v + row_dot(s.jacobian, s.rates + s.width, s.width);
  return v;
}
template <class T>
void push(const PgsContact<T>& c, int32_t row, const T& impulse) {
  for (const RowSide<T>& s : c.sides) {
    if (s.response != nullptr) add_row(s.response + row * s.width, impulse, s.width, s.rates);
  }
}
// Returns J_i Y_j, the change of velocity along row i per impulse along row j.
template <class T>
T row_product(const PgsContact<T>& c, int32_t i, int32_t j) {
  T sum = T(0.0f);
  for (const RowSide<T>& s : c.sides)
    if (s.response != nullptr)
      sum = sum + row_dot(s.jacobian + i * s.width, s.response + j * s.width, s.width);
  return sum;
}
// Returns the largest absolute value of y {count}, at least `least`.
template <class T>
T largest(const T* y, int64_t count, T least) {
  for (int64_t k = 0; k < count; ++k) {
    const T size = select(y[k] < T(0.0f), -y[k], y[k]);
    least = select(size > least, size, least);
  }
  return least;
}
template <class T>
void set_diagonals(PgsContact<T>& c) {
  c.reach = T(0.0f);
  for (const RowSide<T>& s : c.sides)
    if (s.response != nullptr) c.reach = largest(s.response, s.width, c.reach);
  c.normal = c.apart = row_product(c, 0, 0);
  c.tangent[0] = row_product(c, 1, 1);
  c.tangent[1] = row_product(c, 1, 2);
  c.tangent[2] = row_product(c, 2, 2);
}
// Returns s, the largest eigenvalue of the tangents' 2 x 2 block of J Y.
template <class T>
T tangent_bound(const PgsNumbers<T>& c) {
  const T half = T(0.5f), d = (c.tangent[0] - c.tangent[2]) * half;
  return (c.tangent[0] + c.tangent[2]) * half + square_root(d * d + c.tangent[1] * c.tangent[1]);
}

// Returns the softness of rates and shifts for the mass m.
template <class T>
T softness_of_mass(const T& mass) {
  const auto some = mass > T(0.0f);
  return select(some, T(kLeastOfMass) / select(some, mass, T(1.0f)), T(0.0f));
}

// Computes the divisors of sweeps from the diagonals, cfm and shift. 0: nothing moves.
template <class T>
void set_steps(const T& dt, PgsNumbers<T>& c) {
  const T o = T(0.0f);
  const T whole = c.apart + T(kOtherAxes) * (c.normal + (c.tangent[0] + c.tangent[2]));
  const T by_sides = T(kLeastMobility) * whole, by_mass = softness_of_mass(c.mass);
  const T lack = select(by_mass > by_sides, by_mass, by_sides) - c.normal;
  c.cfm = select(lack > c.cfm, lack, c.cfm);
  c.softness = T(kShiftSoftness) * whole + by_mass;
  c.lack = c.shift * c.reach * (dt * T(-1.0f / kMostShift)) - (c.normal + c.softness);
  c.softness = select(c.lack > o, c.softness + c.lack, c.softness);
  c.normal_step = select(c.normal > o, T(1.0f) / (c.normal + c.cfm), o);
  c.bound = tangent_bound(c);
  c.tangent_step = select(c.bound > o, T(1.0f) / c.bound, o);
}

template <class T>
T clamped(const T& x, const T& limit) {
  return select(x > limit, limit, select(x < -limit, -limit, x));
}
template <class T>
void project_friction(const T& limit, bool cone, T& x, T& y) {
  if (cone) {
    const T length2 = x * x + y * y;
    const auto outside = length2 > limit * limit;
    if (!any(outside)) return;
    const T scale = limit / square_root(length2);
    x = select(outside, x * scale, x);
    y = select(outside, y * scale, y);
    return;
  }
  x = clamped(x, limit);
  y = clamped(y, limit);
}

// Sets initial impulses along n, t1, t2 from an earlier step, projected into the friction cone.
template <class T>
void start_from(PgsNumbers<T>& c, bool cone, const T& n, const T& t1, const T& t2) {
  c.impulse[0] = select(n > T(0.0f), n, T(0.0f));
  c.impulse[1] = t1;
  c.impulse[2] = t2;
  project_friction(c.friction * c.impulse[0], cone, c.impulse[1], c.impulse[2]);
}
// Sets initial impulses and applies them to the rates.
template <class T>
void warm_start(PgsContact<T>& c, bool cone, const T& n, const T& t1, const T& t2) {
  start_from<T>(c, cone, n, t1, t2);
  for (int32_t r = 0; r < 3; ++r) push(c, r, c.impulse[r]);
}

// Updates the impulses of one contact in a sweep, in the lanes `active`. slip_of(row) returns J v,
// and push_row(row, impulse) applies an impulse. Returns the largest change of velocity along a row
// (m/s).
template <class T, class Active, class Slip, class Push>
T sweep_contact(PgsNumbers<T>& c, bool cone, const Active& active, const Slip& slip_of,
                const Push& push_row) {
  const T o = T(0.0f);
  T worst = o;
  const auto apply = [&](int32_t row, const T& impulse, const T& diagonal) {
    const T change = select(active, impulse - c.impulse[row], o);
    if (all(change == o)) return;
    const T size = select(change < o, -change, change);
    c.impulse[row] = select(change == o, c.impulse[row], impulse);
    push_row(row, change);
    const T moved = diagonal * size;
    worst = select(moved > worst, moved, worst);
  };
  const T residual = slip_of(0) + c.bias + c.cfm * c.impulse[0];
  const T n = c.impulse[0] - residual * c.normal_step;
  apply(0, select(n > o, n, o), c.normal);
  const T limit = c.friction * c.impulse[0];
  if (all(both(negate(limit > o), both(c.impulse[1] == o, c.impulse[2] == o)))) return worst;
  if (cone) {
    T x = c.impulse[1] - slip_of(1) * c.tangent_step,
      y = c.impulse[2] - slip_of(2) * c.tangent_step;
    project_friction(limit, true, x, y);
    apply(1, x, c.bound);
    apply(2, y, c.bound);
    return worst;
  }
  for (int32_t r = 1; r < 3; ++r) {
    const T a = c.tangent[r == 1 ? 0 : 2];
    const auto moves = a > o;
    const T x = c.impulse[r] - slip_of(r) / select(moves, a, T(1.0f));
    apply(r, select(moves, clamped(x, limit), c.impulse[r]), a);
  }
  return worst;
}
// Updates the normal of one contact in a sweep of shifts, which follow the sweeps of rates.
template <class T, class Active, class Slip, class Push>
T sweep_shift(PgsNumbers<T>& c, const Active& active, const Slip& slip_of, const Push& push_row) {
  const T o = T(0.0f), soft = c.normal + c.softness;
  const T residual = slip_of() + c.shift + c.softness * c.shifted;
  const T x = c.shifted - residual / select(soft > o, soft, T(1.0f));
  const auto holds = either(c.impulse[0] > o, c.shift < T(kMoreSpeed));
  const T next = select(both(both(active, c.normal > o), holds), select(x > o, x, o), c.shifted);
  const T change = next - c.shifted;
  if (all(change == o)) return o;
  c.shifted = next;
  push_row(change);
  return c.normal * select(change < o, -change, change);
}
template <class T>
T sweep_shift(PgsContact<T>& c) {
  return sweep_shift<T>(
      c, true, [&] { return moving_slip(c); },
      [&](const T& impulse) {
        for (const RowSide<T>& s : c.sides)
          if (s.response != nullptr) add_row(s.response, impulse, s.width, s.rates + s.width);
      });
}
template <class T>
T sweep(PgsContact<T>& c, bool cone) {
  return sweep_contact<T>(
      c, cone, true, [&](int32_t row) { return slip(c, row); },
      [&](int32_t row, const T& impulse) { push(c, row, impulse); });
}

// Sweeps are far from convergence if the last change of velocity, `residual`, exceeds this fraction
// of the largest impulse expressed as a velocity.
inline constexpr float kFarPart = 1e-2f;
inline bool far_from_converged(float residual, float largest, float tolerance) {
  return !(residual < tolerance) && !(residual <= kFarPart * largest);
}

// Dry friction of a dof, a constraint row along the dof itself.
template <class T>
struct PgsJointFriction {
  T* rates = nullptr;           // of the tree
  const T* response = nullptr;  // {width}
  int32_t width = 0, dof = 0;
  T limit{}, impulse{};  // friction dt, N s or N m s
};
template <class T>
void push(const PgsJointFriction<T>& f, const T& impulse) {
  add_row(f.response, impulse, f.width, f.rates);
}
// Starts from an impulse of an earlier step, clamped to the limit, and applies it.
template <class T>
void warm_start(PgsJointFriction<T>& f, const T& impulse) {
  f.impulse = clamped(impulse, f.limit);
  push(f, f.impulse);
}
template <class T>
T sweep(PgsJointFriction<T>& f) {
  const T diagonal = f.response[f.dof];
  if (!(diagonal > T(0.0f))) return T(0.0f);
  T x = f.impulse - f.rates[f.dof] / diagonal;
  x = clamped(x, f.limit);
  const T change = x - f.impulse;
  f.impulse = x;
  push(f, change);
  return diagonal * (change < T(0.0f) ? -change : change);
}

}  // namespace novaphy::articulation
