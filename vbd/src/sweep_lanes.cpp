// The sweep of one instruction set: LANES particles of a colour at a time.
#include "sweep_slots.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {
namespace {

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

// The energy of the elements of each particle at x, its contacts under the loads that they have at
// `from`.
Lanes energy_at(const Sweep& sweep, int64_t group, const Point& x, const Point& from) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const float* const q = sweep.x;
  Lanes energy =
      inertia_energy(x, gather(sweep.target, particle), load(sweep.mass_by_h2 + group * LANES));
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& contact, Mask touching, int32_t) {
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

void adjoint(const Sweep& sweep, const Adjoint& bars, int64_t group);
void adjoint_start(const Sweep& sweep, const Adjoint& bars, int64_t group);
void tangent(const Sweep& sweep, const Tangents& tangents, int64_t group);
void tangent_start(const Sweep& sweep, const Tangents& tangents, int64_t group);

extern const SweepLevel kLevel;
const SweepLevel kLevel = {NOVAPHY_LEVEL_NAME, LANES,          &prepare, &move,         &residual,
                           &adjoint,           &adjoint_start, &tangent, &tangent_start};

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
