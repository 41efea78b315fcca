// The coarse correction of VBD, as templates over the scalar of a sweep (sweep_kernels.h). This
// header has the functions over the slots of particles. src/vbd_coarse_kernels.h has the other
// kernels.
//
// A sweep hardly reduces errors that are smooth over many particles. The correction removes these
// errors by one step of Galerkin's method. A system is a connected component of particles that
// move. A system is divided into aggregates: sets of neighboring particles.
//
// Each aggregate has 1 to 4 functions: the constant 1, and linear functions of the rest positions.
// The unknowns a are one vector for each function. P a is the displacement field of the system: the
// sum of each function times its vector. H is the stiffness of the step at the positions after the
// first sweep (stiffness_law.h, inertia, contacts):
//   A = P^T H P,  A a = P^T f,  x += t P a
//
// f are the forces at x. The length t starts at 1. A line search halves t while f(x + t P a).(P a)
// < -f(x).(P a)/2: the forces behind the step push back too hard. After kVbdCoarseTests tests t is
// 0.
//
// The slope f(x).(P a) is twice the energy that a step removes. A step is taken whole without a
// test if its slope is at most kVbdCoarseTrust times the slope of an earlier step. The earlier step
// is the last step that was tested and taken whole. If an untested step is too long, the next slope
// is large enough for a test.
#pragma once

#include "novaphy/vbd/sweep_kernels.h"

namespace novaphy {

constexpr int kVbdCoarseTests = 4;
constexpr float kVbdCoarseTrust = 0.1f;

// The line search of a system: the length t, the slope f.(P a), whether the search has ended (1 or
// 0), and the slope of the last step of this time step that was tested and taken whole.
struct alignas(16) VbdCoarseSearch {
  using Element = Vec4f;  // the element type of arrays of this struct
  float length = 0.0f, slope = 0.0f, is_done = 0.0f, whole = 0.0f;
};

// A table `..._begin` has the first index of each list, and one more entry for the end of the last
// list.
struct VbdCoarseArguments {
  NOVAPHY_ARGUMENTS(
      Part<VbdSweepArguments> sweep; Reads<int32_t> aggregate;  // of each particle; -1: none
      Reads<VbdRow> field;        // of each particle: values of its aggregate's linear functions
      Reads<int32_t> near_begin;  // of each particle: list of near aggregates
      Reads<int32_t> near;
      Reads<int64_t> near_row;        // of each near aggregate: its first matrix in `rows`
      Reads<int32_t> function_begin;  // of each aggregate: its functions
      Reads<int32_t> member_begin;    // of each aggregate: its particles in `members`
      Reads<int32_t> members; Reads<int32_t> function_aggregate;  // of each function
      Reads<int32_t> pairs;         // pairs of functions whose aggregates are near
      Reads<int32_t> system;        // system of each aggregate
      Reads<int32_t> system_begin;  // of each system: its aggregates
      // of each system: 1 if no element connects it to a kinematic particle
      Reads<int32_t> is_free; Reads<int64_t> matrix_begin;  // of each system
      // First H P: a 3x3 matrix for each particle and each near function. Then coarse_outer
      // replaces the first matrix of each particle by its block.
      Updates<float> rows; Updates<float> matrix;  // A, then the factors of A, column by column
      Updates<VbdRow> force;                       // of each particle
      Updates<float> load, step;                   // P^T f and a: 3 numbers for each function
      Updates<VbdCoarseSearch> search;             // of each system
      Updates<VbdRow> shift;                       // of each system
      Number<int64_t> tests;                       // tests of the line search before this launch
  )
};

namespace vbd {

inline int32_t system_of(const VbdCoarseArguments& a, int32_t particle) {
  const int32_t aggregate = a.aggregate[particle];
  return aggregate < 0 ? -1 : a.system[aggregate];
}
// Returns the value of the function `number` of the particle's aggregate at the particle.
inline float function_at(const VbdCoarseArguments& a, int32_t particle, int32_t number) {
  const VbdRow& field = a.field[particle];
  return number == 0 ? 1.0f : number == 1 ? field.x : number == 2 ? field.y : field.z;
}
// Returns the first matrix of a particle and an aggregate near the particle. Null: not near.
inline float* rows_of(const VbdCoarseArguments& a, int32_t particle, int32_t aggregate) {
  for (int32_t k = a.near_begin[particle]; k < a.near_begin[particle + 1]; ++k)
    if (a.near[k] == aggregate) return a.rows + 9 * a.near_row[k];
  return nullptr;
}

// Adds a part of H P: the stiffness h between each particle of the group and its particle
// others[lane], times the functions at others[lane].
template <class S>
void add_stiffness(const VbdCoarseArguments& a, const LaneGroup<S>& g, const int32_t* others,
                   const Mat33<S>& h) {
  using Access = LaneAccess<S>;
  float values[9][Access::kLanes];
  for (int k = 0; k < 9; ++k) Access::store(values[k], h.m[k / 3][k % 3]);
  for (int l = 0; l < g.filled; ++l) {
    const int32_t p = g.particle[l], q = others[l], aggregate = a.aggregate[q];
    if (aggregate < 0 || a.aggregate[p] < 0) continue;
    float of_lane[9];
    for (int k = 0; k < 9; ++k) of_lane[k] = values[k][l];
    float* to = rows_of(a, p, aggregate);
    const int32_t functions = a.function_begin[aggregate + 1] - a.function_begin[aggregate];
    for (int32_t j = 0; j < functions; ++j, to += 9) {
      const float value = function_at(a, q, j);
      for (int k = 0; k < 9; ++k) to[k] = to[k] + value * of_lane[k];
    }
  }
}
template <class S>
void coarse_rows(const VbdCoarseArguments& a, const LaneGroup<S>& g) {
  if (g.filled == 0) return;
  for (int l = 0; l < g.filled; ++l) {
    const int32_t p = g.particle[l];
    const int64_t begin = a.near_row[a.near_begin[p]], end = a.near_row[a.near_begin[p + 1]];
    for (int64_t k = 9 * begin; k < 9 * end; ++k) a.rows[k] = 0.0f;
  }
  const Vec3<S> x = g.at(a.sweep.x);
  Mat33<S> own = stiffness_matrix(inertia_block(x, g.at(a.sweep.target), g.mass_by_h2()) +
                                  contact_blocks(g, x));
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    for_slots<role>(g, [&](const auto& slot) {
      stiffness_of(inputs_of(slot, x, a.sweep.x), g.is_damped(role), [&](int k, const Mat33<S>& h) {
        if (k == 0) {
          add_to(own, h);
        } else {
          add_stiffness(a, g, slot.ints + (k - 1) * LaneAccess<S>::kStride, h);
        }
      });
    });
  });
  add_stiffness(a, g, g.particle, own);
}

// Returns whether the line searches of all particles of a group have ended.
template <class S>
bool is_coarse_done(const VbdCoarseArguments& a, const LaneGroup<S>& g) {
  for (int l = 0; l < g.filled; ++l) {
    const int32_t s = system_of(a, g.particle[l]);
    if (s >= 0 && (a.tests == 0 || a.search[s].is_done == 0.0f)) return false;
  }
  return true;
}
template <class S>
void coarse_force(const VbdCoarseArguments& a, const LaneGroup<S>& g) {
  if (!is_coarse_done(a, g)) g.put(a.force, block_at<Force>(g, g.at(a.sweep.x)).f);
}

// Writes the force and stiffness of inertia and contacts for each particle. The elements are left
// out, because their forces cancel over a free system.
template <class S>
void coarse_outer(const VbdCoarseArguments& a, const LaneGroup<S>& g) {
  using Access = LaneAccess<S>;
  if (g.filled == 0) return;
  const Vec3<S> x = g.at(a.sweep.x);
  const Block<S> b = inertia_block(x, g.at(a.sweep.target), g.mass_by_h2()) + contact_blocks(g, x);
  g.put(a.force, b.f);
  const S all[6] = {b.h00, b.h11, b.h22, b.h01, b.h02, b.h12};
  for (int l = 0; l < g.filled; ++l) {
    const int32_t p = g.particle[l];
    if (a.aggregate[p] < 0) continue;
    float* const to = a.rows + 9 * a.near_row[a.near_begin[p]];
    for (int k = 0; k < 6; ++k) to[k] = Access::get(all[k], l);
  }
}

}  // namespace vbd
}  // namespace novaphy
