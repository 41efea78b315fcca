// The tangent of a step of articulations, by dual numbers; on the host.
#include "diff_articulation_duals.h"
#include "novaphy/nova/host_work.h"

namespace novaphy::diff::detail {
namespace {

class DualArrays {
 public:
  // `tangent` undefined: zero.
  DualFloat* take(const Tensor& values, const Tensor& tangent) {
    std::vector<DualFloat>& to = arrays_.emplace_back(static_cast<size_t>(values.size()));
    const float* x = values.data<float>();
    const float* t = tangent.defined() ? tangent.data<float>() : nullptr;
    for (size_t i = 0; i < to.size(); ++i) to[i] = {x[i], t ? t[i] : 0.0f};
    return to.data();
  }

 private:
  std::vector<std::vector<DualFloat>> arrays_;
};

void write_tangent(const Tensor& to, const articulation::Dual<float>* values) {
  if (!to.defined()) return;
  auto* t = static_cast<float*>(to.range()->data());
  for (int64_t i = 0; i < to.size(); ++i) t[i] = values[i].tangent;
}

void run_jvp(const Step& s, const StepOutputs* from, const StepOutputs& to,
             std::span<const Tensor> t, std::span<const Tensor> tangents) {
  require_converged(s, "jvp");
  DualArrays duals;
  const auto take = [&](const Tensor& values, const Tensor& tangent) {
    return Untyped(duals.take(values, tangent));
  };
  const ArticulationArgumentsOf<DualFloat> a = in_memory(dual_arguments(s, from, t, take));
  const articulation::StepInputs<DualFloat> inputs = articulation_inputs(a);
  const articulation::StepOptions<DualFloat> options = articulation_options(a);
  DualFloat* const q = duals.take(to[0], {});
  DualFloat* const qd = duals.take(to[1], {});
  auto* const body_q = reinterpret_cast<Transform<DualFloat>*>(duals.take(to[2], {}));
  auto* const body_qd = reinterpret_cast<SpatialVector<DualFloat>*>(duals.take(to[3], {}));
  const auto count = static_cast<size_t>(s.count);
  std::vector<std::vector<uint64_t>> memory(count);
  std::vector<articulation::Tree<DualFloat>> all;
  std::vector<articulation::Workspace<DualFloat>> workspaces(count);
  std::vector<char> moves(count);
  for (size_t i = 0; i < count; ++i) {
    const articulation::Tree<DualFloat>& of = all.emplace_back(articulation_tree(a, a.rows[i]));
    memory[i].resize(static_cast<size_t>(
        articulation::workspace_bytes<DualFloat>(of.link_count, of.dof_count) / 8 + 1));
    workspaces[i] =
        articulation::make_workspace<DualFloat>(memory[i].data(), of.link_count, of.dof_count);
    moves[i] =
        articulation::accelerate_again(of, inputs, options, numbers(to[5]), workspaces[i]) < 0;
    if (moves[i]) articulation::free_rates(of, inputs, options, workspaces[i]);
  }
  const bool all_move = std::all_of(moves.begin(), moves.end(), [](char m) { return m != 0; });
  if (all_move && (prepare_contacts(s, nullptr) || t[kJointFriction].defined())) {
    const auto of = [&](size_t i) {
      return s.in(i).defined() ? duals.take(s.in(i), i < t.size() ? t[i] : Tensor()) : nullptr;
    };
    const ContactDuals more = {of(kJointFriction), of(kMu), of(kRestitution), of(kStiffness),
                               of(kDamping)};
    const KeptContacts kept = kept_contacts(s);
    s.shared->pgs->jvp(all, inputs.qd, workspaces, contact_rows_of(s), kept.impulses, kept.friction,
                       s.options, more, s.dt);
  }
  for (size_t i = 0; i < count; ++i) {
    if (!moves[i]) continue;
    articulation::finish_step(all[i], inputs, options, workspaces[i], q, qd, body_q, body_qd);
  }
  write_tangent(tangents[0], q);
  write_tangent(tangents[1], qd);
  write_tangent(tangents[2], &body_q->p.x);
  write_tangent(tangents[3], &body_qd->linear.x);
}

void run_jvp_of_steps(const Step& s, std::span<const Tensor> t, std::span<const Tensor> tangents) {
  std::vector<Tensor> inputs(t.begin(), t.end());
  StepOutputs from = outputs_of(s);
  for (size_t i = 0; i <= s.following.size(); ++i) {
    const StepOutputs to = i == 0 ? from : s.following[i - 1];
    std::array<Tensor, 4> out;
    for (size_t k = 0; k < out.size(); ++k) {
      out[k] = tangents[4 * i + k];
      if (k < 2 && !out[k].defined())
        out[k] = Tensor(to[k].shape(), nova::DType::F32, Device::cpu());
    }
    run_jvp(s, i == 0 ? nullptr : &from, to, inputs, out);
    inputs[kAt.q] = out[0];
    inputs[kAt.qd] = out[1];
    from = to;
  }
  for (size_t i = 4 * (s.following.size() + 1); i < tangents.size(); ++i)
    if (tangents[i].defined())
      std::fill_n(static_cast<float*>(tangents[i].range()->data()), tangents[i].size(), 0.0f);
}

}  // namespace

void submit_jvp(const std::shared_ptr<const Step>& step, std::span<const Tensor> inputs,
                std::span<const Tensor> outputs) {
  if (!step->shared->device.is_cpu()) {
    require_converged(*step, "jvp");
    return launch_jvp(*step, inputs, outputs);
  }
  if (!nova::current_capture()) return run_jvp_of_steps(*step, inputs, outputs);
  const std::vector<Tensor> t(inputs.begin(), inputs.end()), out(outputs.begin(), outputs.end());
  std::vector<Tensor> reads = reads_of(*step);
  reads.insert(reads.end(), t.begin(), t.end());
  if (step->contacts.defined()) reads.push_back(step->contacts);
  nova::capture_host_work({.name = kName,
                           .reads = reads,
                           .results = out,
                           .failure = &step->shared->failure,
                           .run = [step, t, out] { run_jvp_of_steps(*step, t, out); }});
}

}  // namespace novaphy::diff::detail
