// The tangent of a step of articulations, by dual numbers.
#include "diff_articulation_duals.h"
#include "novaphy/dynamics/diff_adjoint_record.h"
#include "tangent_launches.h"

namespace novaphy::diff::detail {
namespace {

// The dual numbers of several arrays, one after the other in memory that steps share.
class DualArrays {
 public:
  explicit DualArrays(const DeviceArray<float>& memory) : memory_(memory) {}
  Untyped take(const Tensor& values, const Tensor& tangent) {
    const Untyped to = part(values.size());
    run(tangent_kernels().pack, values.size(),
        {.values = argument(values), .tangents = argument(tangent), .to = to});
    return to;
  }
  // Returns memory for `count` dual numbers.
  Untyped part(int64_t count) {
    const size_t bytes = static_cast<size_t>(count) * sizeof(DualFloat), begin = used_;
    used_ += bytes;
    return nova::part_of(memory_.range(), begin, bytes);
  }
  static void write_tangent(const Untyped& from, const Tensor& to) {
    if (to.defined()) run(tangent_kernels().tangent, to.size(), {.from = from, .to = argument(to)});
  }

 private:
  const DeviceArray<float>& memory_;
  size_t used_ = 0;  // bytes
};

// Returns the number of dual numbers in all arrays of a step.
int64_t dual_numbers(const Step& s) {
  int64_t sum = 0;
  for (const Named& in : s.inputs) sum += in.tensor.defined() ? in.tensor.size() : 0;
  for (size_t i = kFrameP; i <= kAxis; ++i) sum += s.values[i].tensor.size();
  for (size_t i = 0; i < 4; ++i) sum += s.outputs[i].tensor.size();
  return sum;
}

// Computes the tangent of the step into `to`. `from`: the state at which the step starts. Null: the
// step's inputs.
void run_jvp(const Step& s, const StepOutputs* from, const StepOutputs& to,
             std::span<const Tensor> t, std::span<const Tensor> tangents) {
  require_converged(s, "jvp");
  const bool solves = acts(s, t[kJointFriction]);
  require(solves || !t[kJointFriction].defined(), ErrorKind::Runtime,
          "articulation_step: expected joint_friction to carry a gradient when the step ran");
  const nova::NoGrad no_grad;
  const Unrecorded unrecorded(s.shared->runs_on_host());
  ArticulationStep::Shared& shared = *s.shared;
  const Articulations& trees = shared.articulations;
  const int64_t duals = 2 * dual_numbers(s);
  const int64_t dofs = trees.max_dofs();
  int64_t bytes = articulation::workspace_bytes<DualFloat>(trees.max_links(), trees.max_dofs());
  if (solves) bytes += dofs * dofs * static_cast<int64_t>(sizeof(DualFloat));
  const int64_t stride = bytes / 16 * 4 + 4;
  if (static_cast<int64_t>(shared.duals.size()) < duals + s.count * stride) {
    const UntrackedScope untracked;
    shared.duals = DeviceArray<float>(static_cast<size_t>(duals + s.count * stride), shared.device);
  }
  DualArrays memory(shared.duals);
  const auto take = [&](const Tensor& values, const Tensor& tangent) {
    return memory.take(values, tangent);
  };
  const auto out = [&](size_t i) { return take(to[i], Tensor()); };
  const ArticulationArgumentsOf<DualFloat> in = dual_arguments(s, from, t, take);
  const Untyped results[] = {out(0), out(1), out(2), out(3)};
  const ArticulationJvpArguments a = {.in = in,
                                      .q_next = results[0],
                                      .qd_next = results[1],
                                      .body_q = results[2],
                                      .body_qd = results[3],
                                      .branch = argument(to[5]),
                                      .workspace = memory.part(s.count * stride / 2),
                                      .stride = stride};
  if (solves) {
    const auto more = [&](size_t i) {
      return s.in(i).defined() ? take(s.in(i), i < t.size() ? t[i] : Tensor()) : Untyped(nullptr);
    };
    AdjointRecord::Step* const noted = AdjointRecord::entry_of(&s);
    if (noted != nullptr) noted->changes.resize(static_cast<size_t>(s.contact_max));
    shared.contacts.jvp(a, kept_arguments(s), s.options, contact_record(s),
                        {more(kJointFriction), more(kMu), more(kRestitution), more(kStiffness),
                         more(kDamping), Untyped(noted ? noted->changes.data() : nullptr)});
  } else {
    run(tangent_kernels().step, s.count, a);
  }
  for (size_t i = 0; i < std::size(results); ++i) memory.write_tangent(results[i], tangents[i]);
}

}  // namespace

void submit_jvp(const std::shared_ptr<const Step>& step, std::span<const Tensor> t,
                std::span<const Tensor> tangents) {
  const Step& s = *step;
  std::vector<Tensor> inputs(t.begin(), t.end());
  StepOutputs from = outputs_of(s);
  for (size_t i = 0; i <= s.following.size(); ++i) {
    const StepOutputs to = i == 0 ? from : s.following[i - 1];
    std::array<Tensor, 4> out;
    for (size_t k = 0; k < out.size(); ++k) {
      out[k] = tangents[4 * i + k];
      if (k < 2 && !out[k].defined() && i < s.following.size())
        out[k] = Tensor(to[k].shape(), nova::DType::F32, s.shared->device);
    }
    run_jvp(s, i == 0 ? nullptr : &from, to, inputs, out);
    inputs[kAt.q] = out[0];
    inputs[kAt.qd] = out[1];
    from = to;
  }
  for (size_t i = 4 * (s.following.size() + 1); i < tangents.size(); ++i)
    if (tangents[i].defined()) nova::submit_fill(tangents[i].range(), 0.0f);
  watch_convergence(step, tangents, "jvp");
}

}  // namespace novaphy::diff::detail
