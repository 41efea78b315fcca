#include "contact_forces.h"

#include "novaphy/math/dual.h"
#include "novaphy/vbd/particle_contact_law.h"

namespace novaphy::vbd {
namespace {

using Tangent = math::Dual<float>;
using Point = Vec3<Tangent>;

ParticleContact<Tangent> contact_at(const float* c, const float* law, float slip, float inside) {
  const auto point = [c](int k) {
    return math::with_tangent(Vec3f{c[k], c[k + 1], c[k + 2]}, Vec3f{});
  };
  const auto number = [&](int k) { return Tangent(c[9 + k], law != nullptr ? law[k] : 0.0f); };
  return {point(0),  point(3),  point(6),      number(0),      number(1),
          number(2), number(3), Tangent(slip), Tangent(inside)};
}

}  // namespace

std::vector<VbdContactForce> contact_forces(const Step& step, const StepInputs& in,
                                            const std::vector<Vec3f>& end,
                                            const SweepTangents* along, const Rows& x_tangents) {
  std::vector<VbdContactForce> all;
  if (!step.has_contacts()) return all;
  const std::vector<int32_t> begin = step.contact_begin().to_host(),
                             items = step.contact_items().to_host(),
                             shape = in.contacts->soft_contact_shape.to_host();
  const std::vector<float> numbers = step.contact_numbers().to_host();
  const Rows start = download(step.start());
  const VbdSweepArguments sweep = step.sweep(0, 0);
  for (size_t p = 0; p < end.size(); ++p) {
    const Vec3f moved = along != nullptr ? Vec3f(x_tangents[p]) : Vec3f{};
    const Vec3f moved_start = along != nullptr ? Vec3f(along->start[p]) : Vec3f{};
    const Point x = math::with_tangent(end[p], moved),
                xn = math::with_tangent(Vec3f(start[p]), moved_start);
    for (auto k = static_cast<size_t>(begin[p]); k < static_cast<size_t>(begin[p + 1]); ++k) {
      const float* const law =
          along != nullptr ? along->contacts.data() + k * kContactLawFloats : nullptr;
      const float* const c = numbers.data() + k * kContactFloats;
      const Point f = particle_contact_block<Force>(
                          x, xn, contact_at(c, law, sweep.slip.value, sweep.inside.value))
                          .f;
      const auto slot = static_cast<size_t>(items[k]);
      const VbdContactForce found = {.slot = items[k],
                                     .particle = static_cast<int32_t>(p),
                                     .shape = shape[slot],
                                     .point = {c[0], c[1], c[2]},
                                     .normal = {c[3], c[4], c[5]},
                                     .force = math::value_of(f),
                                     .force_tangent = math::tangent_of(f)};
      if (found.force != Vec3f{}) all.push_back(found);
    }
  }
  return all;
}

std::vector<int32_t> held_contacts(const Step& step, std::span<const int32_t> held) {
  std::vector<int32_t> sorted;
  if (held.empty() || !step.has_contacts()) return sorted;
  const std::vector<int32_t> begin = step.contact_begin().to_host(),
                             items = step.contact_items().to_host();
  for (size_t k = 0; k < static_cast<size_t>(begin.back()); ++k)
    sorted.push_back(held[static_cast<size_t>(items[k])]);
  return sorted;
}

}  // namespace novaphy::vbd
