// The drift of H = p . f of adjoints (AdjointDrift of gradient_info.h).
#include <algorithm>

#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

namespace art = articulation;

void note_drift(const Step& s, const Step* before) {
  MotionNotes& notes = *s.motion;
  const auto version_of = [](const Tensor& t) { return t.range()->version(); };
  for (size_t i = 0; i < 2; ++i) notes.versions[i] = version_of(s.outputs[i].tensor);
  if (before == nullptr) return;
  for (size_t i = 0; i < 2; ++i)
    notes.breaks =
        notes.breaks || before->motion->versions[i] != version_of(before->outputs[i].tensor);
  notes.breaks = notes.breaks || before->dt != s.dt;
  for (size_t m = 0; m < kForces.size(); ++m) {
    const Tensor &now = s.in(kForces[m]), &last = before->in(kForces[m]);
    if (now.range()->data() == last.range()->data()) continue;
    std::vector<float> change(static_cast<size_t>(now.size()));
    for (size_t i = 0; i < change.size(); ++i) change[i] = numbers(now)[i] - numbers(last)[i];
    if (std::any_of(change.begin(), change.end(), [](float x) { return x != 0.0f; }))
      notes.force_change[m] = std::move(change);
  }
}

Costate costate_behind(const Step& s, const ArticulationArguments& in,
                       std::span<const Tensor> outputs) {
  const auto dofs = static_cast<size_t>(s.in(kAt.qd).size());
  Costate p{std::vector<float>(dofs), std::vector<float>(dofs)};
  const ArticulationRows* const rows = rows_of_step(s);
  const float *const q_next = numbers(s.outputs[0].tensor), *const qd_next =
                                                                numbers(s.outputs[1].tensor);
  const float *const of_q = numbers(outputs[0]), *const of_qd = numbers(outputs[1]);
  if (!outputs[2].defined() && !outputs[3].defined()) {
    if (of_qd != nullptr) std::copy_n(of_qd, dofs, p.of_qd.begin());
    for (int64_t t = 0; of_q != nullptr && t < s.count; ++t)
      art::gradient_to_tangent(articulation_tree(in, rows[t]), q_next, of_q,
                               p.of_q.data() + rows[t].first_dof);
    return p;
  }
  const art::StepInputs<float> inputs = articulation_inputs(in);
  const art::StepOutputGradient<float> out = {
      of_q, of_qd, reinterpret_cast<const Transformf*>(numbers(outputs[2])),
      reinterpret_cast<const SpatialVectorf*>(numbers(outputs[3]))};
  for (int64_t t = 0; t < s.count; ++t) {
    const ArticulationRows& of = rows[t];
    const auto words = [](int64_t bytes) { return static_cast<size_t>(bytes / 8 + 1); };
    std::vector<uint64_t> work(words(art::workspace_bytes<float>(of.link_count, of.dof_count)));
    std::vector<uint64_t> memory(words(art::adjoint_bytes<float>(of.link_count, of.dof_count)));
    auto ws = art::make_workspace<float>(work.data(), of.link_count, of.dof_count);
    auto adjoint = art::make_adjoint_memory<float>(memory.data(), of.link_count, of.dof_count);
    art::step_vjp_end(articulation_tree(in, of), inputs, q_next, qd_next, out, ws, adjoint);
    std::copy_n(adjoint.tangent, of.dof_count, p.of_q.data() + of.first_dof);
    std::copy_n(adjoint.rate, of.dof_count, p.of_qd.data() + of.first_dof);
  }
  return p;
}

namespace {

// Returns p . f at the start of a step. f has the rates after the step without contacts that hit,
// and the accelerations of the step.
double product(const float* of_q, const float* of_qd, const float* qd,
               const std::vector<float>& qdd, float dt) {
  double sum = 0.0;
  for (size_t k = 0; k < qdd.size(); ++k)
    sum += double{of_q[k]} * (double{qd[k]} + double{dt} * qdd[k]) + double{of_qd[k]} * qdd[k];
  return sum;
}

bool is_far(const Step& s) { return s.contacts.defined() && kept_contacts(s).far->sweeps != 0; }

}  // namespace

void drift_vjp(const Step& s, std::span<const Tensor> outputs,
               std::span<const nova::InputGradient> gradients, const Adjoint& run) {
  const MotionNotes& notes = *s.motion;
  const std::shared_ptr<MotionNotes> next = notes.next.lock();
  for (const auto& drift : notes.drifts)
    if (drift != nullptr) drift->visit(notes.order);
  if (next == nullptr) return run(gradients);
  if (next->breaks || is_far(s)) {
    for (const auto& drift : notes.drifts)
      if (drift != nullptr) ++drift->skipped;
    return run(gradients);
  }
  std::vector<nova::InputGradient> all(gradients.begin(), gradients.end());
  std::vector<size_t> own = {kAt.q, kAt.qd};
  for (size_t m = 0; m < kForces.size(); ++m)
    if (!next->force_change[m].empty()) own.push_back(kForces[m]);
  for (const size_t i : own) all[i] = own_gradient(s, i);
  run(all);

  const ArticulationArguments in = host_arguments(s);
  const ArticulationRows* const rows = rows_of_step(s);
  std::vector<float> tangent(static_cast<size_t>(s.in(kAt.qd).size()));
  for (int64_t t = 0; t < s.count; ++t)
    art::gradient_to_tangent(articulation_tree(in, rows[t]), numbers(s.in(kAt.q)),
                             numbers(all[kAt.q].grad), tangent.data() + rows[t].first_dof);
  const Costate p = costate_behind(s, in, outputs);
  const double h =
      product(tangent.data(), numbers(all[kAt.qd].grad), numbers(s.in(kAt.qd)), notes.smooth, s.dt);
  double m =
      h - product(p.of_q.data(), p.of_qd.data(), numbers(s.outputs[1].tensor), next->smooth, s.dt);
  for (size_t f = 0; f < kForces.size(); ++f)
    for (size_t i = 0; i < next->force_change[f].size(); ++i)
      m += double{numbers(all[kForces[f]].grad)[i]} * next->force_change[f][i] / double{s.dt};
  for (const auto& drift : notes.drifts)
    if (drift != nullptr) drift->add(m, h, notes.number);
  for (const size_t i : own) give_gradient(all[i], gradients[i]);
}

}  // namespace novaphy::diff::detail
