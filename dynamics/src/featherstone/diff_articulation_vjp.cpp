// The adjoint of a step of articulations.
#include "diff_articulation_parts.h"
#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/nova/host_work.h"

namespace novaphy::diff::detail {
namespace {

// The object is never destroyed, because recordings refer to the kernels.
struct Kernels {
  Kernel<ArticulationStepVjpArguments> vjp{kInChunks<articulation_step_vjp, kTreeRows>,
                                           novaphy::detail::articulation_kernels_source};
  Kernel<GravityGradientArguments> gravity{gravity_gradient,
                                           novaphy::detail::articulation_kernels_source};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

// Returns memory for the gradient by body_f, from which the gradient by gravity is computed.
DeviceArray<float>& wrench_memory(const Step& s) {
  const auto numbers_of = static_cast<size_t>(s.in(kAt.body_f).size());
  DeviceArray<float>& memory = s.shared->wrenches;
  if (memory.size() != numbers_of) {
    const UntrackedScope untracked;
    memory = DeviceArray<float>(numbers_of, s.shared->device);
  }
  return memory;
}
// Calls `adjoint` with the arguments, and computes the gradient by gravity. `gravity.add`: adds to
// that gradient.
template <class Adjoint>
void with_gravity(const Step& s, ArticulationStepVjpArguments a, const nova::InputGradient& gravity,
                  bool add, const Tensor& body_f, const Adjoint& adjoint) {
  if (!gravity.grad.defined()) return adjoint(a);
  constexpr int64_t kWrench = int64_t{1} << kAt.body_f;
  const bool add_body_f = (a.add.value & kWrench) != 0;
  a.gradient.body_f = Untyped(wrench_memory(s));
  a.add.value &= ~kWrench;
  adjoint(a);
  const GravityGradientArguments of_gravity = {.rows = a.in.rows,
                                               .links = a.in.links,
                                               .mass = a.in.arrays.mass,
                                               .wrenches = a.gradient.body_f,
                                               .gravity = argument(gravity.grad),
                                               .body_f = argument(body_f),
                                               .count = s.count,
                                               .bodies = s.in(kAt.body_f).size() / 6,
                                               .worlds = gravity.grad.size() / 3,
                                               .add_gravity = add,
                                               .add_body_f = add_body_f};
  if (s.shared->runs_on_host())
    gravity_gradient_row(in_memory(of_gravity), 0, 1);
  else
    run(kernels().gravity, 1, of_gravity);
}

// Returns the arguments of the adjoint of the first step, from the gradients by its outputs.
// with_gravity computes the gradient by gravity.
ArticulationStepVjpArguments vjp_arguments(const Step& s, const ArticulationArguments& in,
                                           const Tensor* outputs,
                                           std::span<const nova::InputGradient> gradients) {
  int64_t add = 0;
  for (size_t i = 0; i < kGradientArrays; ++i)
    if (gradients[i].add) add |= int64_t{1} << i;
  const auto gradient = [&](int32_t place) {
    return place == kAt.gravity ? Untyped(nullptr)
                                : argument(gradients[static_cast<size_t>(place)].grad);
  };
  return {.in = in,
          .q_next = argument(s.outputs[0].tensor),
          .qd_next = argument(s.outputs[1].tensor),
          .qdd = argument(s.outputs[4].tensor),
          .branch = argument(s.outputs[5].tensor),
          .out_q = argument(outputs[0]),
          .out_qd = argument(outputs[1]),
          .out_body_q = argument(outputs[2]),
          .out_body_qd = argument(outputs[3]),
          .gradient = step_arguments<articulation::GradientArrays<WantedArrays>, 0>(
              gradient, std::make_index_sequence<kGradientArrays>()),
          .add = add,
          .workspace = s.workspace,
          .stride = s.stride};
}

}  // namespace

void run_vjp_of_steps(const Step& s, std::span<const Tensor> outputs,
                      std::span<const nova::InputGradient> gradients) {
  require(!nova::current_capture(), ErrorKind::NotImplemented,
          "articulation_step: backward inside a ScopedCapture of a rollout outside of it is not "
          "there");
  ArticulationStepVjpArguments a = vjp_arguments(s, *s.host, outputs.data(), gradients);
  int64_t add = a.add;
  bool add_gravity = gradients[kAt.gravity].add;
  constexpr int64_t kState = 1 << kAt.q | 1 << kAt.qd;
  const auto q_first = a.gradient.q, qd_first = a.gradient.qd;
  std::vector<float>& between = s.shared->between;
  const auto nq = static_cast<size_t>(s.in(kAt.q).size());
  const auto nv = static_cast<size_t>(s.in(kAt.qd).size());
  between.resize(2 * (nq + nv));
  for (size_t i = s.following.size() + 1; i-- > 0;) {
    const bool last = i == s.following.size(), first = i == 0;
    const auto array = [&](size_t step, size_t k) {
      return argument(step == 0 ? s.outputs[k].tensor : s.following[step - 1][k]);
    };
    float* const to = between.data() + (i % 2) * (nq + nv);
    float* const carried = between.data() + ((i + 1) % 2) * (nq + nv);
    a.in.arrays.q = first ? argument(s.in(kAt.q)) : array(i - 1, 0);
    a.in.arrays.qd = first ? argument(s.in(kAt.qd)) : array(i - 1, 1);
    a.q_next = array(i, 0);
    a.qd_next = array(i, 1);
    a.qdd = array(i, 4);
    a.branch = array(i, 5);
    const Tensor* const mine = outputs.data() + 4 * i;
    a.out_q = last ? argument(mine[0]) : Untyped(carried);
    a.out_qd = last ? argument(mine[1]) : Untyped(carried + nq);
    a.out_body_q = argument(mine[2]);
    a.out_body_qd = argument(mine[3]);
    if (first) {
      a.gradient.q = q_first;
      a.gradient.qd = qd_first;
    } else {
      a.gradient.q = direct(to);
      a.gradient.qd = direct(to + nq);
    }
    a.add = first ? add : add & ~kState;
    with_gravity(s, a, gradients[kAt.gravity], add_gravity, gradients[kAt.body_f].grad,
                 [&](const ArticulationStepVjpArguments& all) {
                   s.shared->trees->vjp(in_memory(all), *s.model, s.shared->all);
                 });
    add |= ~kState;
    add_gravity = true;
    if (first) continue;
    const float *const of_q = numbers(mine[-4]), *const of_qd = numbers(mine[-3]);
    for (size_t k = 0; of_q != nullptr && k < nq; ++k) to[k] += of_q[k];
    for (size_t k = 0; of_qd != nullptr && k < nv; ++k) to[nq + k] += of_qd[k];
  }
}

namespace {

void run_vjp(const Step& s, std::span<const Tensor> outputs,
             std::span<const nova::InputGradient> gradients) {
  const nova::NoGrad no_grad;
  const Unrecorded unrecorded(s.shared->runs_on_host());
  require_converged(s, "backward");
  for (size_t i = kJointFriction; i < gradients.size(); ++i)
    if (gradients[i].grad.defined() && !gradients[i].add)
      nova::submit_fill(gradients[i].grad.range(), 0.0f);
  const auto of = [&](size_t i) { return i < gradients.size() ? gradients[i].grad : Tensor(); };
  AdjointRecord::Step* const noted = AdjointRecord::entry_of(&s);
  const auto adjoint = [&](const ArticulationStepVjpArguments& a) {
    ArticulationStep::Shared& shared = *s.shared;
    if (acts(s, of(kJointFriction)))
      return shared.contacts.vjp(
          a, kept_arguments(s), s.options, contact_record(s),
          {argument(of(kJointFriction)), argument(of(kMu)), argument(of(kRestitution)),
           argument(of(kStiffness)), argument(of(kDamping)),
           Untyped(noted == nullptr ? nullptr : noted->notes.data())});
    if (!shared.runs_on_host()) return run(kernels().vjp, s.count, a);
    shared.trees->vjp(in_memory(a), *s.model, shared.all);
  };
  with_gravity(s, vjp_arguments(s, step_arguments_of(s), outputs.data(), gradients),
               gradients[kAt.gravity], gradients[kAt.gravity].add, gradients[kAt.body_f].grad,
               adjoint);
}

}  // namespace

void submit_vjp(const std::shared_ptr<const Step>& step, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients) {
  run_vjp(*step, outputs, gradients);
  std::vector<Tensor> results;
  for (const nova::InputGradient& gradient : gradients)
    if (gradient.grad.defined()) results.push_back(gradient.grad);
  watch_convergence(step, results, "backward");
}

}  // namespace novaphy::diff::detail
