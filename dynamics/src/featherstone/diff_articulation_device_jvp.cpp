// The tangent of a step of articulations on devices.
#include "diff_articulation_duals.h"
#include "tangent_launches.h"

namespace novaphy::diff::detail {
namespace {

// Dual numbers of arrays, one behind the other in memory that steps share.
class LaunchedDuals {
 public:
  LaunchedDuals(Device device, const DeviceArray<float>& memory)
      : device_(device), memory_(memory) {}
  LaunchArgument part(const DualFloat* first, bool write) const {
    LaunchArgument a = write ? updates("duals", memory_) : reads("duals", memory_);
    a.word = reinterpret_cast<uint64_t>(first);
    return std::move(a).detached();
  }
  DualFloat* take(const Tensor& values, const Tensor& tangent) {
    DualFloat* const to = static_cast<DualFloat*>(memory_.range()->data()) + used_;
    used_ += values.size();
    tangent_kernels().pack.launch(
        device_, values.size(),
        {argument("values", values, false), argument("tangents", tangent, false), part(to, true)});
    return to;
  }
  void write_tangent(const DualFloat* from, const Tensor& to) const {
    if (!to.defined()) return;
    tangent_kernels().tangent.launch(
        device_, to.size(), {part(from, false), argument("tangent of an output", to, true)});
  }

 private:
  Device device_;
  const DeviceArray<float>& memory_;
  int64_t used_ = 0;
};

// Of all arrays of a step.
int64_t dual_numbers(const Step& s) {
  int64_t sum = 0;
  for (const Named& in : s.inputs) sum += in.tensor.defined() ? in.tensor.size() : 0;
  for (size_t i = kFrameP; i <= kAxis; ++i) sum += s.values[i].tensor.size();
  for (size_t i = 0; i < 4; ++i) sum += s.outputs[i].tensor.size();
  return sum;
}

}  // namespace

void launch_jvp(const Step& s, std::span<const Tensor> t, std::span<const Tensor> tangents) {
  const bool solves = s.contacts.defined();
  require(solves || !t[kJointFriction].defined(), ErrorKind::Runtime,
          "articulation_step: expected joint_friction to carry a gradient when the step ran");
  const nova::NoGrad no_grad;
  ArticulationStep::Shared& shared = *s.shared;
  const Articulations& trees = shared.articulations;
  const int64_t duals = 2 * dual_numbers(s);
  const int64_t dofs = trees.max_dofs();
  int64_t bytes = articulation::workspace_bytes<DualFloat>(trees.max_links(), trees.max_dofs());
  if (solves) bytes += dofs * dofs * static_cast<int64_t>(sizeof(DualFloat));
  const int64_t stride = bytes / 16 * 4 + 4;
  if (static_cast<int64_t>(shared.duals.size()) < duals + s.count * stride) {
    const Unobserved unobserved;
    shared.duals = DeviceArray<float>(static_cast<size_t>(duals + s.count * stride), shared.device);
  }
  LaunchedDuals memory(shared.device, shared.duals);
  const auto take = [&](const Tensor& values, const Tensor& tangent) {
    return memory.take(values, tangent);
  };
  ArticulationJvpArguments a = {};
  a.in = dual_arguments(s, nullptr, t, take);
  const auto out = [&](size_t i) { return take(s.outputs[i].tensor, Tensor()); };
  a.q_next = out(0);
  a.qd_next = out(1);
  a.body_q = reinterpret_cast<Transform<DualFloat>*>(out(2));
  a.body_qd = reinterpret_cast<SpatialVector<DualFloat>*>(out(3));
  a.workspace = static_cast<float*>(shared.duals.range()->data()) + duals;
  a.stride = stride;
  std::vector<LaunchArgument> words(sizeof(a) / sizeof(uint64_t));
  const auto* const values = reinterpret_cast<const uint64_t*>(&a);
  for (size_t i = 0; i < words.size(); ++i) words[i] = number(static_cast<int64_t>(values[i]));
  for (size_t i = kTargetMode; i < kValues; ++i)
    words[kGradientArrays + i] = argument(s.values[i].name, s.values[i].tensor, false);
  words[kArticulationWords] = memory.part(a.q_next, true);
  words[kArticulationWords + 4] = argument(s.outputs[5].name, s.outputs[5].tensor, false);
  if (solves) {
    const auto more = [&](size_t i) {
      if (!s.in(i).defined()) return LaunchArgument();
      return memory.part(take(s.in(i), i < t.size() ? t[i] : Tensor()), false);
    };
    shared.launched->jvp(
        std::move(words), kept_arguments(s, false), s.options, contact_record(s, false),
        {more(kJointFriction), more(kMu), more(kRestitution), more(kStiffness), more(kDamping)});
  } else {
    tangent_kernels().step.launch(shared.device, s.count, words);
  }
  const DualFloat* const results[] = {a.q_next, a.qd_next,
                                      reinterpret_cast<const DualFloat*>(a.body_q),
                                      reinterpret_cast<const DualFloat*>(a.body_qd)};
  for (size_t i = 0; i < tangents.size(); ++i) {
    if (i < std::size(results))
      memory.write_tangent(results[i], tangents[i]);
    else if (tangents[i].defined())
      nova::submit_fill(tangents[i].range(), 0.0f);
  }
}

}  // namespace novaphy::diff::detail
