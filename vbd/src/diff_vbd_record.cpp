// Entries of an AdjointRecord for steps of VBD. The force of a contact adds to the external force
// on its particle. The adjoint of the contact's impulse is therefore the gradient by the external
// force, divided by dt.

#include "diff_vbd_step.h"
#include "novaphy/dynamics/semi_implicit/contact_gradients.h"

namespace novaphy::diff {
namespace {

void append(const Array& from, std::vector<float>& to) {
  const auto* const values = static_cast<const float*>(from.raw());
  to.insert(to.end(), values, values + from.bytes() / sizeof(float));
}
// Appends the values of a tensor, or `size` zeros if the tensor is undefined.
void append(const nova::Tensor& from, size_t size, std::vector<float>& to) {
  const std::vector<float> values = from.defined() ? from.to_host() : std::vector<float>(size);
  to.insert(to.end(), values.begin(), values.end());
}

}  // namespace

void RecordedStep::add_to(AdjointRecord& record, std::span<const nova::Tensor> outputs,
                          std::span<const Array> values) const {
  AdjointRecord::Step& to = record.add(this);
  to.number = number;
  to.dt = dt;
  to.of_springs = true;
  const auto size = static_cast<size_t>(q.size());
  for (const size_t k : {kQ, kQd}) append(values[k], to.start);
  for (const nova::Tensor& output : outputs) append(output, size, to.end);
  append(qd_out, to.rates);
  const std::vector<float> before = qd.to_host();
  for (size_t k = 0; k < size; ++k) to.rates.push_back((to.rates[k] - before[k]) / dt);
  const auto* const by_force = static_cast<const Vec3f*>(values[kForces].raw());
  for (const VbdContactForce& c : steps->contact_forces(inputs())) {
    const auto p = static_cast<size_t>(c.particle), s = static_cast<size_t>(c.shape);
    const int32_t world = model->particle_world.data()[p];
    to.contacts.push_back({.row = c.slot,
                           .world = world < 0 ? model->shape_world.data()[s] : world,
                           .shape0 = c.shape,
                           .shape1 = -1,
                           .point = c.point,
                           .normal = c.normal,
                           .impulse = c.force * dt,
                           .adjoint = by_force[p] * (1.0f / dt),
                           .held = !is_exact_while_frozen(*model, c.shape),
                           .particle = c.particle});
  }
}

std::vector<int32_t> RecordedStep::held_rows(const AdjointRecord::Step& entry) const {
  const AdjointRecord* const record = AdjointRecord::current();
  if (!record->holds || contacts == nullptr) return {};
  std::vector<int32_t> held(static_cast<size_t>(contacts->soft_contact_max()));
  for (const AdjointRecord::Contact& c : entry.contacts)
    held[static_cast<size_t>(c.row)] = record->holds(c) ? 1 : 0;
  return held;
}

void RecordedStep::note_changes(AdjointRecord::Step& entry, std::span<const int32_t> held) const {
  if (held.empty()) return;
  for (const VbdContactForce& c : steps->contact_forces(inputs())) {
    const auto row = static_cast<size_t>(c.slot);
    if (held[row] != 0) entry.changes[row] = c.force_tangent * dt;
  }
}

}  // namespace novaphy::diff
