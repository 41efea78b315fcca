// The derivative of the sweep of one instruction set along a direction.
//
// A particle moves by d = H^-1 f, so d' = H^-1 (f' - H' d): at a solution, where f = 0, H^-1 f'.
#include "novaphy/vbd/slot_inputs_law.h"
#include "sweep_slots.h"
// Behind lanes.h, which says what functions of lanes are.
#include "novaphy/vbd/tangent_law.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {
namespace {

using Tangent = TangentOf<Lanes>;

Point rows_or_zero(const float* rows, const int32_t* particle) {
  return rows != nullptr ? gather(rows, particle) : Point{};
}

void put_row(float* rows, int32_t particle, const Point& value, int32_t lane) {
  float* const row = rows + 4 * static_cast<int64_t>(particle);
  row[0] = value.x.v[lane];
  row[1] = value.y.v[lane];
  row[2] = value.z.v[lane];
}

// At the positions q with the derivatives dq; `numbers`: the rows of their derivatives, or null.
template <Role role>
SlotInputs<role, Tangent> inputs_of(const Slot<role>& slot, const Vec3<Tangent>& x, const float* q,
                                    const float* dq, const float* numbers) {
  SlotInputs<role, Tangent> in;
  in.own = x;
  for (int k = 0; k < kOthers[role]; ++k) {
    const int32_t* const index = slot.index(other_place<role>(k));
    in.others[k] = with_slope(gather(q, index), rows_or_zero(dq, index));
  }
  for (int k = 0; k < kFloats[role]; ++k)
    in.numbers[k] =
        Tangent(slot.number(k), numbers != nullptr ? load(numbers + k * LANES) : Lanes());
  return in;
}

template <Role role>
float* numbers_of(const Tangents& t, const SlotTable& table, const Slot<role>& slot) {
  return t.numbers[role] == nullptr
             ? nullptr
             : t.numbers[role] + slot_number(table, slot) * (kFloats[role] * LANES);
}

template <Role role>
void add_slots(const Sweep& sweep, const Tangents& t, int64_t group, const Vec3<Tangent>& x,
               Block<Tangent>& block) {
  const SlotTable& table = sweep.slots[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    const auto in = inputs_of(slot, x, sweep.x, t.x, numbers_of(t, table, slot));
    block = block + block_of(in, table.damped);
  });
}

Block<Tangent> contacts_of(const Sweep& sweep, const Tangents& t, int64_t group,
                           const Vec3<Tangent>& x) {
  Block<Tangent> outer;
  if (sweep.contact_begin == nullptr) return outer;
  const int32_t* const particle = sweep.particle + group * LANES;
  const Vec3<Tangent> start =
      with_slope(gather(sweep.start, particle), rows_or_zero(t.start, particle));
  const Point still;
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& c, Mask touching, int32_t round) {
    Lanes slopes[kContactLawFloats];
    for (int32_t l = 0; t.contacts != nullptr && l < sweep.filled[group]; ++l) {
      const int32_t k = sweep.contact_begin[particle[l]] + round;
      if (k >= sweep.contact_begin[particle[l] + 1]) continue;
      for (int n = 0; n < kContactLawFloats; ++n)
        slopes[n].v[l] = t.contacts[static_cast<int64_t>(k) * kContactLawFloats + n];
    }
    if (t.keeps_loads) slopes[3] = slope_that_keeps_load(value_of(x), slope_of(x), c);
    const ParticleContact<Tangent> contact = {
        with_slope(c.point, still),  with_slope(c.normal, still),
        with_slope(c.travel, still), {c.radius, slopes[0]},
        {c.ke, slopes[1]},           {c.kd_by_h, slopes[2]},
        {c.mu, slopes[3]},           Tangent(c.slip)};
    outer = outer + where(touching, particle_contact_block(x, start, contact));
  });
  return outer;
}

// In the order of block_at.
Block<Tangent> tangent_block(const Sweep& sweep, const Tangents& t, int64_t group,
                             const Vec3<Tangent>& x) {
  const int32_t* const particle = sweep.particle + group * LANES;
  Block<Tangent> outer = contacts_of(sweep, t, group, x);
  add_slots<kSpring>(sweep, t, group, x, outer);
  Lanes mass_slope;
  for (int32_t l = 0; t.mass_by_h2 != nullptr && l < sweep.filled[group]; ++l)
    mass_slope.v[l] = t.mass_by_h2[particle[l]];
  Block<Tangent> block =
      inertia_block(x, with_slope(gather(sweep.target, particle), rows_or_zero(t.target, particle)),
                    Tangent(load(sweep.mass_by_h2 + group * LANES), mass_slope));
  add_slots<kTriangle>(sweep, t, group, x, block);
  add_slots<kHingeOpposite>(sweep, t, group, x, block);
  add_slots<kHingeEnd>(sweep, t, group, x, block);
  add_slots<kTetrahedron>(sweep, t, group, x, block);
  return block + outer;
}

template <Role role>
void tangent_start_slots(const Sweep& sweep, const Tangents& t, int64_t group,
                         const Vec3<Tangent>& x) {
  const SlotTable& table = sweep.slots[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    float* const rows = numbers_of(t, table, slot);
    const auto in = inputs_of(slot, x, sweep.start, t.start, rows);
    start_of_slot(in, [&](int k, const Tangent& value) {
      store(rows + (kFloats[role] - kStartFloats[role] + k) * LANES, value.d);
    });
  });
}

}  // namespace

void tangent(const Sweep& sweep, const Tangents& t, int64_t group);
void tangent_start(const Sweep& sweep, const Tangents& t, int64_t group);

void tangent(const Sweep& sweep, const Tangents& t, int64_t group) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const Vec3<Tangent> x = with_slope(gather(sweep.x, particle), rows_or_zero(t.x, particle));
  const Block<Tangent> b = tangent_block(sweep, t, group, x);
  const Point f = value_of(b.f), slope = slope_of(b.f);
  Point step;
  if (t.step_slope != nullptr) {
    const Block<Lanes> block = {f, b.h00.v, b.h11.v, b.h22.v, b.h01.v, b.h02.v, b.h12.v};
    const auto factors = factorize(block, Lanes(sweep.regularization));
    Point load = slope + rows_or_zero(t.load, particle);
    if (!t.at_rest) {
      const Block<Lanes> turned = {slope, b.h00.d, b.h11.d, b.h22.d, b.h01.d, b.h02.d, b.h12.d};
      load = load - multiply_stiffness(turned, solve_block(factors, f));
    }
    step = solve_block(factors, load);
  }
  for (int32_t l = 0; l < sweep.filled[group]; ++l) {
    if (t.force != nullptr) put_row(t.force, particle[l], f, l);
    if (t.force_slope != nullptr) put_row(t.force_slope, particle[l], slope, l);
    if (t.step_slope != nullptr) put_row(t.step_slope, particle[l], step, l);
  }
}

void tangent_start(const Sweep& sweep, const Tangents& t, int64_t group) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const Vec3<Tangent> x =
      with_slope(gather(sweep.start, particle), rows_or_zero(t.start, particle));
  tangent_start_slots<kSpring>(sweep, t, group, x);
  tangent_start_slots<kTriangle>(sweep, t, group, x);
  tangent_start_slots<kHingeOpposite>(sweep, t, group, x);
  tangent_start_slots<kHingeEnd>(sweep, t, group, x);
  tangent_start_slots<kTetrahedron>(sweep, t, group, x);
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
