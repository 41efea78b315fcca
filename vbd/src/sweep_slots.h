// The inputs of the sweeps of one instruction set: slots, contacts, and the blocks that they add up
// to.
#pragma once

#include "lanes.h"
#include "novaphy/vbd/bending_law.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "novaphy/vbd/spring_law.h"
#include "novaphy/vbd/tetrahedron_law.h"
#include "sweep.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {
using Point = Vec3<Lanes>;

// One slot: its rows of indices and constants.
template <Role role>
struct Slot {
  const int32_t* ints;
  float* floats;
  Slot(const SlotTable& table, int64_t s)
      : ints(table.ints + s * (kInts[role] * LANES)),
        floats(table.floats + s * (kFloats[role] * LANES)) {}
  const int32_t* index(int k) const { return ints + k * LANES; }
  Lanes number(int k) const { return load(floats + k * LANES); }
  void set(int k, Lanes value) const { store(floats + k * LANES, value); }
};

template <Role role>
int64_t slot_number(const SlotTable& table, const Slot<role>& slot) {
  return (slot.ints - table.ints) / (kInts[role] * LANES);
}

template <Role role, class Body>
void for_slots(const Sweep& sweep, int64_t group, Body&& body) {
  const SlotTable& table = sweep.slots[role];
  if (table.begin == nullptr) return;
  for (int64_t s = table.begin[group]; s < table.begin[group + 1]; ++s) body(Slot<role>(table, s));
}

using SpringSlot = Slot<kSpring>;
using TriangleSlot = Slot<kTriangle>;
using TetrahedronSlot = Slot<kTetrahedron>;

inline SpringLaw<Lanes> spring_law(const SpringSlot& s) {
  return {s.number(0), s.number(1), s.number(2)};
}

inline MembraneWeights<Lanes> weights_of(const TriangleSlot& s) {
  return {{s.number(0), s.number(1)}, {s.number(2), s.number(3)}};
}
inline MembraneLaw<Lanes> law_of(const TriangleSlot& s) {
  return {s.number(4), s.number(5), s.number(6), s.number(7)};
}
inline MembraneStrain<Lanes> start_of(const TriangleSlot& s) {
  return {s.number(8), s.number(9), s.number(10)};
}

inline TetrahedronWeights<Lanes> weights_of(const TetrahedronSlot& s) {
  return {{s.number(0), s.number(1), s.number(2)},
          {s.number(3), s.number(4), s.number(5)},
          {s.number(6), s.number(7), s.number(8)}};
}
inline TetrahedronLaw<Lanes> law_of(const TetrahedronSlot& s) {
  return {s.number(9), s.number(10), s.number(11), s.number(12)};
}
inline TetrahedronStrain<Lanes> start_of(const TetrahedronSlot& s) {
  TetrahedronStrain<Lanes> start;
  for (int k = 0; k < 6; ++k) start.c[k] = s.number(13 + k);
  return start;
}

template <Role role>
BendingLaw<Lanes> bending_law(const Slot<role>& s) {
  return {s.number(0), s.number(1), s.number(2)};
}

// The four vertices of a hinge; the particle itself at place `own`.
template <int own>
struct HingeCorners {
  Point x[4];
  template <class S>
  HingeCorners(const S& slot, const Point& self, const float* table) {
    for (int k = 0; k < 4; ++k) x[k] = k == own ? self : gather(table, slot.index(k));
  }
};

// Calls body(contact of each lane, lanes that have one, which one it is of their contacts) for the
// contacts of a group.
template <class Body>
void for_contacts(const Sweep& sweep, int64_t group, Body&& body) {
  if (sweep.contact_begin == nullptr) return;
  const int32_t* const particle = sweep.particle + group * LANES;
  const int32_t filled = sweep.filled[group];
  for (int32_t round = 0;; ++round) {
    float rows[kContactFloats][LANES] = {};
    Mask touching;
    bool any = false;
    for (int32_t l = 0; l < filled; ++l) {
      const int32_t k = sweep.contact_begin[particle[l]] + round;
      if (k >= sweep.contact_begin[particle[l] + 1]) continue;
      for (int c = 0; c < kContactFloats; ++c)
        rows[c][l] = sweep.contacts[static_cast<int64_t>(k) * kContactFloats + c];
      touching.v[l] = -1;
      any = true;
    }
    if (!any) return;
    const auto point = [&](int c) {
      return Point{load(rows[c]), load(rows[c + 1]), load(rows[c + 2])};
    };
    body(ParticleContact<Lanes>{point(0), point(3), point(6), load(rows[9]), load(rows[10]),
                                load(rows[11]), load(rows[12]), Lanes(sweep.slip)},
         touching, round);
  }
}

// The block of the particles of a group at x, in this order: contacts and springs; then inertia,
// triangles, bending edges, tetrahedra; then both sums.
inline Block<Lanes> block_at(const Sweep& sweep, int64_t group, const Point& x) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const float* const q = sweep.x;
  Block<Lanes> outer;
  if (sweep.contact_begin != nullptr) {
    const Point start = gather(sweep.start, particle);
    for_contacts(sweep, group, [&](const ParticleContact<Lanes>& contact, Mask touching, int32_t) {
      outer = outer + where(touching, particle_contact_block(x, start, contact));
    });
  }
  for_slots<kSpring>(sweep, group, [&](const SpringSlot& s) {
    outer = outer + spring_block(x, gather(q, s.index(0)), spring_law(s), s.number(3));
  });

  Block<Lanes> block =
      inertia_block(x, gather(sweep.target, particle), load(sweep.mass_by_h2 + group * LANES));
  const bool tri_damped = sweep.slots[kTriangle].damped;
  for_slots<kTriangle>(sweep, group, [&](const TriangleSlot& s) {
    block = block + membrane_block(x, gather(q, s.index(0)), gather(q, s.index(1)), weights_of(s),
                                   law_of(s), start_of(s), tri_damped);
  });
  for_slots<kHingeOpposite>(sweep, group, [&](const Slot<kHingeOpposite>& s) {
    const HingeCorners<0> at(s, x, q);
    block = block +
            bending_opposite_block(at.x[0], at.x[1], at.x[2], at.x[3], bending_law(s), s.number(3));
  });
  for_slots<kHingeEnd>(sweep, group, [&](const Slot<kHingeEnd>& s) {
    const HingeCorners<2> at(s, x, q);
    block =
        block + bending_end_block(at.x[0], at.x[1], at.x[2], at.x[3], bending_law(s), s.number(3));
  });
  const bool tet_damped = sweep.slots[kTetrahedron].damped;
  for_slots<kTetrahedron>(sweep, group, [&](const TetrahedronSlot& s) {
    block = block + tetrahedron_block(x, gather(q, s.index(0)), gather(q, s.index(1)),
                                      gather(q, s.index(2)), weights_of(s), law_of(s), start_of(s),
                                      tet_damped);
  });
  return block + outer;
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
