// Reads slots and contacts of a group for kernels of VBD on devices, a lane at a time, and adds up
// their block. The laws and the order of their sums are those of sweep_slots.h, so the results have
// the same bits.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/vbd/bending_law.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "novaphy/vbd/rows_kernels.h"
#include "novaphy/vbd/slot_layout_law.h"
#include "novaphy/vbd/spring_law.h"
#include "novaphy/vbd/tetrahedron_law.h"

namespace novaphy {

// Lanes of a group on devices; groups of a team where there are many; terms that a team has room
// for (see vbd_move_team).
constexpr int kVbdLanes = 4, kVbdLargeTeam = 8, kVbdTeamTerms = 832;

struct VbdSweepArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle;        // of each lane of each group
                    Reads<int32_t> filled;          // lanes of a group that are particles
                    Reads<float> mass_by_h2;        // of each lane
                    Each<Reads<int64_t>, 5> begin;  // by role: the slots of a group
                    Each<Reads<int32_t>, 5> ints; Each<Updates<float>, 5> floats;
                    Optional<Reads<int32_t>> contact_begin;  // null: no contacts
                    Optional<Reads<float>> contacts; Reads<VbdRow> start, target;
                    Updates<VbdRow> moved, x,
                    to;  // where the particles of a colour go: x, or memory of its own
                    Number<float> regularization, slip; Number<int64_t> lanes;  // of a group
                    Number<int64_t> damped;                                     // bit of each role
                    Number<int64_t> first_group, end_group,
                    team;                    // groups of a team: 1 or kVbdLargeTeam
                    Writes<float> residual;  // of vbd_residual
  )
};

namespace vbd {

inline Vec3f at(const VbdRow* rows, int32_t p) { return to_vec3(rows[p]); }

// Slot s of a role, for one lane.
template <Role role>
struct LaneSlot {
  const int32_t* ints;
  float* floats;
  LaneSlot(const VbdSweepArguments& a, int64_t s, int32_t lane)
      : ints(a.ints[role] + s * (kInts[role] * kVbdLanes) + lane),
        floats(a.floats[role] + s * (kFloats[role] * kVbdLanes) + lane) {}
  int32_t index(int k) const { return ints[k * kVbdLanes]; }
  float number(int k) const { return floats[k * kVbdLanes]; }
  void set(int k, float value) const { floats[k * kVbdLanes] = value; }
};

inline MembraneWeights<float> weights_of(const LaneSlot<kTriangle>& s) {
  return {{s.number(0), s.number(1)}, {s.number(2), s.number(3)}};
}
inline TetrahedronWeights<float> weights_of(const LaneSlot<kTetrahedron>& s) {
  return {{s.number(0), s.number(1), s.number(2)},
          {s.number(3), s.number(4), s.number(5)},
          {s.number(6), s.number(7), s.number(8)}};
}
template <Role role>
BendingLaw<float> bending_law(const LaneSlot<role>& s) {
  return {s.number(0), s.number(1), s.number(2)};
}

// The block of one slot for the particle at x.
inline Block<float> block_of(const LaneSlot<kSpring>& s, const VbdSweepArguments& a,
                             const Vec3f& x) {
  return spring_block(x, at(a.x, s.index(0)),
                      SpringLaw<float>{s.number(0), s.number(1), s.number(2)}, s.number(3));
}
inline Block<float> block_of(const LaneSlot<kTriangle>& s, const VbdSweepArguments& a,
                             const Vec3f& x) {
  return membrane_block(x, at(a.x, s.index(0)), at(a.x, s.index(1)), weights_of(s),
                        MembraneLaw<float>{s.number(4), s.number(5), s.number(6), s.number(7)},
                        MembraneStrain<float>{s.number(8), s.number(9), s.number(10)},
                        (a.damped >> kTriangle) & 1);
}
inline Block<float> block_of(const LaneSlot<kHingeOpposite>& s, const VbdSweepArguments& a,
                             const Vec3f& x) {
  return bending_opposite_block(x, at(a.x, s.index(1)), at(a.x, s.index(2)), at(a.x, s.index(3)),
                                bending_law(s), s.number(3));
}
inline Block<float> block_of(const LaneSlot<kHingeEnd>& s, const VbdSweepArguments& a,
                             const Vec3f& x) {
  return bending_end_block(at(a.x, s.index(0)), at(a.x, s.index(1)), x, at(a.x, s.index(3)),
                           bending_law(s), s.number(3));
}
inline Block<float> block_of(const LaneSlot<kTetrahedron>& s, const VbdSweepArguments& a,
                             const Vec3f& x) {
  TetrahedronStrain<float> start;
  for (int k = 0; k < 6; ++k) start.c[k] = s.number(13 + k);
  return tetrahedron_block(
      x, at(a.x, s.index(0)), at(a.x, s.index(1)), at(a.x, s.index(2)), weights_of(s),
      TetrahedronLaw<float>{s.number(9), s.number(10), s.number(11), s.number(12)}, start,
      (a.damped >> kTetrahedron) & 1);
}

template <Role role, class Body>
void for_lane_slots(const VbdSweepArguments& a, int64_t group, int32_t lane, const Body& body) {
  if (a.begin[role] == nullptr) return;
  for (int64_t s = a.begin[role][group]; s < a.begin[role][group + 1]; ++s)
    body(LaneSlot<role>(a, s, lane));
}

inline ParticleContact<float> contact_of(const VbdSweepArguments& a, int32_t k) {
  const float* const n = a.contacts + static_cast<int64_t>(k) * kContactFloats;
  return {{n[0], n[1], n[2]}, {n[3], n[4], n[5]}, {n[6], n[7], n[8]}, n[9], n[10], n[11], n[12],
          a.slip.value};
}
// What the contacts of a particle add up to.
inline Block<float> contact_blocks(const VbdSweepArguments& a, int32_t p, const Vec3f& x) {
  Block<float> outer;
  if (a.contact_begin == nullptr) return outer;
  const Vec3f start = at(a.start, p);
  for (int32_t k = a.contact_begin[p]; k < a.contact_begin[p + 1]; ++k)
    outer = outer + particle_contact_block(x, start, contact_of(a, k));
  return outer;
}

// The block of a particle, in the order of sweep_slots.h.
inline Block<float> block_at(const VbdSweepArguments& a, int64_t group, int32_t lane,
                             const Vec3f& x) {
  const int64_t k = group * kVbdLanes + lane;
  const int32_t p = a.particle[k];
  Block<float> outer = contact_blocks(a, p, x);
  for_lane_slots<kSpring>(a, group, lane,
                          [&](const LaneSlot<kSpring>& s) { outer = outer + block_of(s, a, x); });
  Block<float> block = inertia_block(x, at(a.target, p), a.mass_by_h2[k]);
  const auto add = [&](const auto& s) { block = block + block_of(s, a, x); };
  for_lane_slots<kTriangle>(a, group, lane, add);
  for_lane_slots<kHingeOpposite>(a, group, lane, add);
  for_lane_slots<kHingeEnd>(a, group, lane, add);
  for_lane_slots<kTetrahedron>(a, group, lane, add);
  return block + outer;
}

}  // namespace vbd
}  // namespace novaphy
