// The sweep of one instruction set: LANES particles of a colour at a time.
#include "lanes.h"
#include "novaphy/vbd/bending_trace.h"
#include "novaphy/vbd/membrane_trace.h"
#include "novaphy/vbd/particle_contact_trace.h"
#include "novaphy/vbd/spring_trace.h"
#include "novaphy/vbd/tetrahedron_trace.h"
#include "sweep.h"

namespace novaphy::vbd::NOVAPHY_VBD_LEVEL {
namespace {

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

template <Role role, class Body>
void for_slots(const Sweep& sweep, int64_t group, Body&& body) {
  const SlotTable& table = sweep.slots[role];
  if (table.begin == nullptr) return;
  for (int64_t s = table.begin[group]; s < table.begin[group + 1]; ++s) body(Slot<role>(table, s));
}

using SpringSlot = Slot<kSpring>;
using TriangleSlot = Slot<kTriangle>;
using TetrahedronSlot = Slot<kTetrahedron>;

SpringLaw<Lanes> spring_law(const SpringSlot& s) { return {s.number(0), s.number(1), s.number(2)}; }

MembraneWeights<Lanes> weights_of(const TriangleSlot& s) {
  return {{s.number(0), s.number(1)}, {s.number(2), s.number(3)}};
}
MembraneLaw<Lanes> law_of(const TriangleSlot& s) {
  return {s.number(4), s.number(5), s.number(6), s.number(7)};
}
MembraneStrain<Lanes> start_of(const TriangleSlot& s) {
  return {s.number(8), s.number(9), s.number(10)};
}

TetrahedronWeights<Lanes> weights_of(const TetrahedronSlot& s) {
  return {{s.number(0), s.number(1), s.number(2)},
          {s.number(3), s.number(4), s.number(5)},
          {s.number(6), s.number(7), s.number(8)}};
}
TetrahedronLaw<Lanes> law_of(const TetrahedronSlot& s) {
  return {s.number(9), s.number(10), s.number(11), s.number(12)};
}
TetrahedronStrain<Lanes> start_of(const TetrahedronSlot& s) {
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

void prepare(const Sweep& sweep, int64_t group) {
  const float* const q = sweep.start;
  const Point x = gather(q, sweep.particle + group * LANES);
  for_slots<kSpring>(sweep, group, [&](const SpringSlot& s) {
    s.set(3, spring_length(x, gather(q, s.index(0))));
  });
  if (sweep.slots[kTriangle].damped)
    for_slots<kTriangle>(sweep, group, [&](const TriangleSlot& s) {
      const auto c =
          membrane_strain(x, gather(q, s.index(0)), gather(q, s.index(1)), weights_of(s));
      s.set(8, c.c00);
      s.set(9, c.c01);
      s.set(10, c.c11);
    });
  const auto angle = [q](const auto& s, const auto& at) {
    s.set(3, bending_angle(at.x[0], at.x[1], at.x[2], at.x[3]));
  };
  if (sweep.slots[kHingeOpposite].damped) {
    for_slots<kHingeOpposite>(
        sweep, group, [&](const Slot<kHingeOpposite>& s) { angle(s, HingeCorners<0>(s, x, q)); });
    for_slots<kHingeEnd>(sweep, group,
                         [&](const Slot<kHingeEnd>& s) { angle(s, HingeCorners<2>(s, x, q)); });
  }
  if (sweep.slots[kTetrahedron].damped)
    for_slots<kTetrahedron>(sweep, group, [&](const TetrahedronSlot& s) {
      const auto c = tetrahedron_strain(x, gather(q, s.index(0)), gather(q, s.index(1)),
                                        gather(q, s.index(2)), weights_of(s));
      for (int k = 0; k < 6; ++k) s.set(13 + k, c.c[k]);
    });
}

// Calls body(contact of each lane, lanes that have one) for the contacts of a group.
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
         touching);
  }
}

// The block of the particles of a group at x, in this order: contacts and springs; then inertia,
// triangles, bending edges, tetrahedra; then both sums.
Block<Lanes> block_at(const Sweep& sweep, int64_t group, const Point& x) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const float* const q = sweep.x;
  Block<Lanes> outer;
  if (sweep.contact_begin != nullptr) {
    const Point start = gather(sweep.start, particle);
    for_contacts(sweep, group, [&](const ParticleContact<Lanes>& contact, Mask touching) {
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

// The energy of the elements of each particle at x, its contacts under the loads that they have at
// `from`.
Lanes energy_at(const Sweep& sweep, int64_t group, const Point& x, const Point& from) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const float* const q = sweep.x;
  Lanes energy =
      inertia_energy(x, gather(sweep.target, particle), load(sweep.mass_by_h2 + group * LANES));
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& contact, Mask touching) {
    const Lanes load = particle_contact_load(from, contact);
    const Lanes e = particle_contact_energy(x, gather(sweep.start, particle), contact, load);
    energy = energy + select(touching, e, Lanes(0.0f));
  });
  for_slots<kSpring>(sweep, group, [&](const SpringSlot& s) {
    energy = energy + spring_energy(x, gather(q, s.index(0)), spring_law(s), s.number(3));
  });
  for_slots<kTriangle>(sweep, group, [&](const TriangleSlot& s) {
    energy = energy + membrane_energy(x, gather(q, s.index(0)), gather(q, s.index(1)),
                                      weights_of(s), law_of(s), start_of(s));
  });
  const auto bending = [&](const auto& s, const auto& at) {
    energy =
        energy + bending_energy(at.x[0], at.x[1], at.x[2], at.x[3], bending_law(s), s.number(3));
  };
  for_slots<kHingeOpposite>(
      sweep, group, [&](const Slot<kHingeOpposite>& s) { bending(s, HingeCorners<0>(s, x, q)); });
  for_slots<kHingeEnd>(sweep, group,
                       [&](const Slot<kHingeEnd>& s) { bending(s, HingeCorners<2>(s, x, q)); });
  for_slots<kTetrahedron>(sweep, group, [&](const TetrahedronSlot& s) {
    energy =
        energy + tetrahedron_energy(x, gather(q, s.index(0)), gather(q, s.index(1)),
                                    gather(q, s.index(2)), weights_of(s), law_of(s), start_of(s));
  });
  return energy;
}

// The step, halved where the energy would rise, up to four times; then none.
Point guarded_step(const Sweep& sweep, int64_t group, const Point& x, Point d) {
  const Lanes before = energy_at(sweep, group, x, x), half(0.5f);
  for (int halvings = 0;; ++halvings) {
    const Mask good = energy_at(sweep, group, x + d, x) <= before;
    int32_t bad = 0;
    for (int32_t l = 0; l < sweep.filled[group]; ++l) bad += good.v[l] == 0;
    if (bad == 0) return d;
    if (halvings == 4) return math::select(good, d, Point{});
    d = math::select(good, d, d * half);
  }
}

void move(const Sweep& sweep, int64_t group) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const Point x = gather(sweep.x, particle);
  const Block<Lanes> block = block_at(sweep, group, x);
  Point d = solve_block(factorize(block, Lanes(sweep.regularization)), block.f);
  if (sweep.safeguard) d = guarded_step(sweep, group, x, d);
  const Point moved = gather(sweep.moved, particle) + d;
  const Point next = gather(sweep.start, particle) + moved;
  const auto put = [&](float* table, int32_t l, const Point& value) {
    float* const row = table + 4 * static_cast<int64_t>(particle[l]);
    row[0] = value.x.v[l];
    row[1] = value.y.v[l];
    row[2] = value.z.v[l];
  };
  float* const target = sweep.step != nullptr ? sweep.step : sweep.x;
  for (int32_t l = 0; l < sweep.filled[group]; ++l) {
    put(sweep.moved, l, moved);
    put(target, l, next);
  }
}

void residual(const Sweep& sweep, int64_t group, ParticleResidual* of_particles) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const Point x = gather(sweep.x, particle);
  const Block<Lanes> b = block_at(sweep, group, x);
  const Point travel = (gather(sweep.target, particle) - gather(sweep.start, particle)) *
                       load(sweep.mass_by_h2 + group * LANES);
  const Lanes size = max(abs(x.x), max(abs(x.y), abs(x.z)));
  const Point rounded = multiply_stiffness(b, Point{size, size, size} * Lanes(0x1p-24f));
  const Lanes force = math::dot(b.f, b.f), inertia = math::dot(travel, travel),
              rounding = math::dot(rounded, rounded);
  for (int32_t l = 0; l < sweep.filled[group]; ++l)
    of_particles[particle[l]] = {force.v[l], inertia.v[l], rounding.v[l]};
}

}  // namespace

extern const SweepLevel kLevel;
const SweepLevel kLevel = {NOVAPHY_VBD_LEVEL_NAME, LANES, &prepare, &move, &residual};

}  // namespace novaphy::vbd::NOVAPHY_VBD_LEVEL
