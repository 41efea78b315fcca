// The derivatives of the coarse correction of VBD (coarse_kernels.h), as templates over the scalar
// of a sweep.
//
// A coarse step solves A a = P^T f for the unknowns a, and moves the particles by t d with d = P a.
// Let xbar be the adjoint of the moved positions, and u = t P A^-1 P^T xbar. The derivative of t
// d.xbar is the derivative of u.f - u.(H d) with constant u and d. f are the forces at the
// positions before the step. H is the stiffness at the positions after the first sweep. The length
// t is constant.
//
// The tangent along a direction is a' = A^-1 P^T (f' - H' d). The balance of free systems has the
// same form, with inertia and contacts alone.
#pragma once

#include "novaphy/vbd/sweep_adjoint_kernels.h"
#include "novaphy/vbd/sweep_tangent_kernels.h"

namespace novaphy::vbd {

// Adds the adjoints of the inputs of inertia and contacts for given u and d. The function leaves
// the elements out.
template <class S>
void reverse_outer(const VbdAdjointArguments& a, const LaneGroup<S>& g) {
  if (g.filled != 0) g.add(a.x_adjoint, reverse_particles(a, g, g.at(a.sweep.x), Block<S>()).own);
}
// Adds the adjoints of -u.(H d) for given u and d. H is the stiffness of a coarse step.
template <class S>
void reverse_stiffness(const VbdAdjointArguments& a, const LaneGroup<S>& g) {
  using Access = LaneAccess<S>;
  if (g.filled == 0) return;
  const Vec3<S> x = g.at(a.sweep.x), u = g.at(a.multiplier), d = step_of<S>(a, g.particle);
  Block<S> of_stiffness = adjoints_of(u, d);
  of_stiffness.f = {};
  Vec3<S> own, by_start;
  reverse_contacts(ContactCase<false>(), a, g, x, of_stiffness, own, by_start);
  g.add(a.start_adjoint, by_start);
  const S by_mass = math::dot(u, d);
  for (int l = 0; l < g.filled; ++l) {
    float& mass = a.mass_adjoint[g.particle[l]];
    mass = mass - Access::get(by_mass, l);
  }
  if (Access::kLanes == 1) g.put(a.own, own);
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    for_slots<role>(g, [&](const auto& slot) {
      Vec3<S> steps[kOthers[role] + 1] = {d};
      for (int k = 0; k < kOthers[role]; ++k)
        steps[k + 1] = step_of<S>(a, slot.ints + k * Access::kStride);
      own = own + reverse_stiffness_of(a, slot, x, u, steps, false);
    });
  });
  if (Access::kLanes != 1) g.add(a.x_adjoint, own);
}

// Writes -H' d to force_tangent for a given d. H' is the tangent of the stiffness.
template <class S>
void tangent_stiffness(const VbdTangentArguments& a, const LaneGroup<S>& g) {
  using Access = LaneAccess<S>;
  using math::select;
  if (g.filled == 0) return;
  const TangentGroup<S> of = {a, g};
  const auto moving = of.place(g.particle);
  const Vec3<S> x = g.at(a.sweep.x), own = math::tangent_of(moving), d = step_of<S>(a, g.particle);
  const auto outer = multiply_stiffness(of.contacts(moving), of.still(d));
  Vec3<S> sum = math::tangent_of(outer) + d * of.mass().d;
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    for_slots<role>(g, [&](const Slot<role, S>& slot) {
      Vec3<S> steps[kOthers[role] + 1] = {d}, along[kOthers[role] + 1] = {own};
      for (int k = 0; k < kOthers[role]; ++k) {
        const int32_t* const p = slot.ints + k * Access::kStride;
        steps[k + 1] = step_of<S>(a, p);
        along[k + 1] = gather_apart<S>(a.x, p);
      }
      const auto numbers = of.numbers(slot);
      S part[3];
      for (int c = 0; c < 3; ++c) {
        const Vec3<S> unit = {S(c == 0 ? 1.0f : 0.0f), S(c == 1 ? 1.0f : 0.0f),
                              S(c == 2 ? 1.0f : 0.0f)};
        SlotAdjoints<role, S> by;
        stiffness_adjoint_of(slot, x, a.sweep.x, unit, steps, by);
        part[c] = math::dot(by.own, own);
        for (int k = 0; k < kOthers[role]; ++k)
          part[c] = part[c] + math::dot(by.others[k], along[k + 1]);
        // Skips zero tangents, because lanes without an element may have infinite derivatives.
        for (int k = 0; k < kFloats[role]; ++k) {
          const S t = numbers[k].d;
          part[c] = part[c] + select(t * t > S(0.0f), by.numbers[k] * t, S(0.0f));
        }
      }
      sum = sum + Vec3<S>{part[0], part[1], part[2]};
    });
  });
  g.put(a.force_tangent, -sum);
}

}  // namespace novaphy::vbd
