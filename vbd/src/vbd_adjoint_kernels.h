// A color of VBD in reverse on devices (sweep_adjoint_kernels.h), as three launches. First,
// vbd_adjoint_solve computes the multipliers u and the steps d of the particles, with one thread
// for each particle. (vbd_adjoint_solve_by_blocks computes the same with thread blocks.) Second,
// vbd_adjoint_slots computes the adjoints of the positions and parameters of slots, with one thread
// for each lane of a slot. Third, vbd_receive (vbd_gradient_kernels.h) adds these terms in slot
// order.
#pragma once

#include "novaphy/vbd/coarse_adjoint_kernels.h"
#include "novaphy/vbd/slot_blocks_kernels.h"

namespace novaphy {

NOVAPHY_BLOCK_KERNEL(vbd_adjoint_solve, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_solve_by_blocks, VbdAdjointArguments);

namespace vbd {

// Calls body(slot, particle) for the lane of a slot that a row of the launch handles.
template <class Body>
inline void for_slot_of(const VbdAdjointArguments& a, int64_t row, const Body& body) {
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    const int64_t before = role == 0 ? 0 : a.ends[role > 0 ? role - 1 : 0].value;
    if (row < before || row >= a.ends[role]) return;
    const int64_t i = a.first[role] + (row - before);
    const int32_t particle = a.slot_particle[a.begins[role] + i];
    if (particle >= 0)
      body(Slot<role, float>(a.sweep, i / kVbdLanes, static_cast<int32_t>(i % kVbdLanes)),
           particle);
  });
}
template <bool at_solution>
inline void reverse_slots(const VbdAdjointArguments& a, int64_t row) {
  for_slot_of(a, row, [&](const auto& slot, int32_t p) {
    const Vec3f x = to_vec3(a.sweep.x[p]), u = to_vec3(a.u[p]), d = to_vec3(a.d[p]);
    if (at_solution || !turns(a, slot)) {
      reverse_slot<at_solution>(a, slot, x, adjoints_of(u, d));
    } else {
      reverse_slot<true>(a, slot, x, adjoints_of(u, d));
      reverse_turning(a, slot, x, u, d);
    }
  });
}

}  // namespace vbd

// A row is a lane of a slot. vbd_adjoint_solution is the kernel for a solution. vbd_adjoint_start
// computes the adjoints of the slots' values at the start of the step.
NOVAPHY_ROW_KERNEL(vbd_adjoint_slots, VbdAdjointArguments) { vbd::reverse_slots<false>(a, row); }
NOVAPHY_ROW_KERNEL(vbd_adjoint_solution, VbdAdjointArguments) { vbd::reverse_slots<true>(a, row); }
NOVAPHY_ROW_KERNEL(vbd_adjoint_start, VbdAdjointArguments) {
  vbd::for_slot_of(a, row, [&](const auto& slot, int32_t p) {
    vbd::reverse_start(a, slot, to_vec3(a.sweep.start[p]));
  });
}

// The adjoints of coarse steps. A row is a lane of the groups of the launch.
NOVAPHY_ROW_KERNEL(vbd_adjoint_outer, VbdAdjointArguments) {
  vbd::reverse_outer(a, vbd::LaneGroup<float>(a.sweep, row));
}
NOVAPHY_ROW_KERNEL(vbd_adjoint_stiffness, VbdAdjointArguments) {
  vbd::reverse_stiffness(a, vbd::LaneGroup<float>(a.sweep, row));
}
NOVAPHY_ROW_KERNEL(vbd_tangent_stiffness, VbdTangentArguments) {
  vbd::tangent_stiffness(a, vbd::LaneGroup<float>(a.sweep, row));
}

#ifdef NOVAPHY_KERNEL
namespace vbd {

// Computes u and d of a particle from its block, and the adjoints of the inputs of its inertia and
// contacts.
struct SolveParticle {
  using Lane = LaneGroup<float>;
  const VbdAdjointArguments& a;
  explicit SolveParticle(const VbdAdjointArguments& arguments) : a(arguments) {}
  void ask(const Lane&) {}
  Vec3f place(const Lane& g) const { return g.at(a.before != nullptr ? a.before : a.sweep.x); }
  void put(const Lane& g, const Block<float>& block) const {
    const Reversed<float> of = reverse_particles(a, g, place_before(a, g), block);
    g.put(a.u, of.u);
    g.put(a.d, of.d);
    g.put(a.own, of.own);
  }
};

}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_adjoint_solve, VbdAdjointArguments) {
  using namespace vbd;
  const int64_t row = block * 128 + static_cast<int64_t>(threadIdx.x);
  if (row >= (a.sweep.end_group - a.sweep.first_group) * kVbdLanes) return;
  const LaneGroup<float> g(a.sweep, row);
  const SolveParticle finish(a);
  if (g.filled != 0)
    finish.put(g, a.multiplier != nullptr ? Block<float>() : block_at(g, finish.place(g)));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_solve_by_blocks, VbdAdjointArguments) {
  __shared__ vbd::BlockMemory memory;
  vbd::for_blocks<vbd::SolveParticle>(a.sweep, a, a.sweep.first_group, a.sweep.end_group, block,
                                      blocks, memory);
}
#endif

}  // namespace novaphy
