// Entries of an AdjointRecord for steps of articulations.
#include <algorithm>

#include "diff_articulation_motion.h"
#include "novaphy/core/error.h"

namespace novaphy::diff::detail {
namespace {

std::vector<float> joined(const std::vector<float>& a, const float* b, size_t count) {
  std::vector<float> both(a);
  both.insert(both.end(), b, b + count);
  return both;
}

using articulation::ContactNote;

void add_contacts(const Step& s, AdjointRecord::Step& to) {
  const auto* const notes = reinterpret_cast<const ContactNote*>(to.notes.data());
  const KeptContacts kept = kept_contacts(s);
  const int32_t* const world = s.model->shape_world.data();
  for (int32_t row = 0; row < std::min(*kept.count, static_cast<int32_t>(s.contact_max)); ++row) {
    if (!(kept.impulses[row].x > 0.0f)) continue;
    const int32_t a = kept.shape0[row], b = kept.shape1[row];
    const int32_t of = world[a] < 0 ? world[b] : world[a];
    const ContactNote& n = notes[row];
    to.contacts.push_back({row, of, a, b, n.point, n.normal, n.impulse, n.adjoint, n.held != 0});
  }
}

}  // namespace

void record_vjp(const Step& s, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run,
                AdjointRecord& record) {
  require(s.shared->runs_on_host() && !nova::current_capture(), ErrorKind::NotImplemented,
          "backward, record: not supported on a device or inside a ScopedCapture");
  std::vector<nova::InputGradient> all(gradients.begin(), gradients.end());
  for (const size_t i : {kAt.q, kAt.qd}) all[i] = own_gradient(s, i);
  AdjointRecord::Step& to = record.add(&s);
  const bool pushes = s.contacts.defined() && s.following.empty();
  constexpr size_t kNumbers = sizeof(ContactNote) / sizeof(float);
  to.notes.resize(pushes ? static_cast<size_t>(s.contact_max) * kNumbers : 0);
  run(all);

  const ArticulationArguments in = host_arguments(s);
  const ArticulationRows* const rows = rows_of_step(s);
  const auto dofs = static_cast<size_t>(s.in(kAt.qd).size());
  to.number = s.number;
  to.dt = s.dt;
  std::vector<float> tangent(dofs);
  for (int64_t t = 0; t < s.count; ++t)
    articulation::gradient_to_tangent(articulation_tree(in, rows[t]), numbers(s.in(kAt.q)),
                                      numbers(all[kAt.q].grad), tangent.data() + rows[t].first_dof);
  to.start = joined(tangent, numbers(all[kAt.qd].grad), dofs);
  if (s.following.empty()) {
    const Costate p = costate_behind(s, in, outputs);
    to.end = joined(p.of_q, p.of_qd.data(), dofs);
    const float *const after = numbers(s.outputs[1].tensor), *const before = numbers(s.in(kAt.qd));
    to.rates.assign(after, after + dofs);
    for (size_t k = 0; k < dofs; ++k) to.rates.push_back((after[k] - before[k]) / s.dt);
  }
  if (pushes) add_contacts(s, to);
  to.notes.clear();
  for (const size_t i : {kAt.q, kAt.qd}) give_gradient(all[i], gradients[i]);
}

void record_delays(const Step& s, const ArticulationArguments& in, std::span<const float> delay,
                   std::span<const float> jump, std::span<const float> qdd,
                   std::span<const char> inside) {
  AdjointRecord::Step* const entry = AdjointRecord::entry_of(&s);
  if (entry == nullptr || entry->end.empty()) return;
  const float *const p_q = entry->end.data(), *const p_qd = p_q + jump.size();
  const std::vector<float>& smooth = s.motion->smooth;
  entry->moved.assign(static_cast<size_t>(s.contact_max), 0.0f);
  for (const ContactEvent& event : s.motion->found.events) {
    const auto tree = static_cast<size_t>(event.trees.front());
    if (event.lands || inside[tree] != 0) continue;
    double sum = 0.0, impulses = 0.0;
    for_dofs(s, event, [&](size_t, size_t row) {
      const double a{smooth[row]}, v = double{in.arrays.qd[row]} + double{s.dt} * a;
      const double after{numbers(s.outputs[1].tensor)[row]};
      sum += (double{p_q[row]} * (v - after) + double{p_qd[row]} * (a - double{qdd[row]})) *
             double{delay[tree]};
      sum += double{p_q[row]} * double{jump[row]};
    });
    const auto is_of_event = [&](const AdjointRecord::Contact& c) {
      return std::ranges::any_of(event.groups, [&](const ContactEvent::Group& g) {
        return std::minmax(g.shape0, g.shape1) == std::minmax(c.shape0, c.shape1);
      });
    };
    const auto size = [](const Vec3f& v) { return double{math::length(v)}; };
    for (const AdjointRecord::Contact& c : entry->contacts)
      if (is_of_event(c)) impulses += size(c.impulse);
    for (const AdjointRecord::Contact& c : entry->contacts)
      if (is_of_event(c))
        entry->moved[static_cast<size_t>(c.row)] =
            static_cast<float>(sum * size(c.impulse) / impulses);
  }
}

}  // namespace novaphy::diff::detail
