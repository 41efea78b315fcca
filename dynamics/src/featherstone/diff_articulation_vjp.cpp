// The adjoint of a step of articulations.
#include "diff_articulation_parts.h"
#include "novaphy/nova/host_work.h"

namespace novaphy::diff::detail {
namespace {

constexpr size_t kGradientWords = kArticulationWords + 8;  // before `gradient` of the adjoint

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel vjp{articulation_step_vjp, novaphy::detail::articulation_kernels_text};
  DeviceKernel gravity{gravity_gradient, novaphy::detail::articulation_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

// Memory for the gradients of body_f, from which gravity's follow.
DeviceArray<float>& wrench_memory(const Step& s) {
  const auto numbers_of = static_cast<size_t>(s.in(G::kBodyF).size());
  DeviceArray<float>& memory = s.shared->wrenches;
  if (memory.size() != numbers_of) {
    const Unobserved unobserved;
    memory = DeviceArray<float>(numbers_of, s.shared->device);
  }
  return memory;
}
std::vector<LaunchArgument> gravity_words(const Step& s, const Tensor& gravity, bool add_gravity,
                                          const Tensor& body_f, bool add_body_f) {
  return {argument("rows", s.values[0].tensor, false),
          argument("links", s.values[1].tensor, false),
          argument("body_mass", s.in(G::kMass), false),
          reads("gradient of body_f", s.shared->wrenches),
          argument("gradient of gravity", gravity, true),
          argument("gradient of body_f", body_f, true),
          number(s.count),
          number(s.in(G::kBodyF).size() / 6),
          number(gravity.size() / 3),
          number(int64_t{add_gravity}),
          number(int64_t{add_body_f})};
}
// Calls `adjoint` with the arguments, and gives gravity its gradient (undefined: nobody wants it).
template <class Adjoint>
void with_gravity(const Step& s, ArticulationStepVjpArguments a, const Tensor& gravity, bool add,
                  const Tensor& body_f, const Adjoint& adjoint) {
  if (!gravity.defined()) return adjoint(a);
  constexpr int32_t kWrench = 1 << G::kBodyF;
  const bool add_body_f = (a.gradient.add & kWrench) != 0;
  a.gradient.body_f = reinterpret_cast<SpatialVectorf*>(wrench_memory(s).mutable_data());
  a.gradient.add &= ~kWrench;
  adjoint(a);
  gravity_gradient_row(
      to_arguments<GravityGradientArguments>(gravity_words(s, gravity, add, body_f, add_body_f)), 0,
      1);
}

}  // namespace

void run_vjp_of_steps(const Step& s, std::span<const Tensor> outputs,
                      std::span<const nova::InputGradient> gradients) {
  require(!nova::current_capture(), ErrorKind::NotImplemented,
          "articulation_step: backward inside a ScopedCapture of a rollout outside of it is not "
          "there");
  ArticulationStepVjpArguments a = {
      s.host,  nullptr, nullptr, nullptr, nullptr, {}, {}, const_cast<float*>(s.workspace.data()),
      s.stride};
  float** const members = reinterpret_cast<float**>(&a.gradient);
  int32_t add = 0;
  for (size_t i = 0; i < G::kMembers; ++i) {
    members[i] = numbers(gradients[i].grad);
    if (gradients[i].add) add |= int32_t{1} << i;
  }
  bool add_gravity = gradients[kGravity].add;
  constexpr int32_t kState = 1 << G::kQ | 1 << G::kQd;
  float *const q_first = a.gradient.q, *const qd_first = a.gradient.qd;
  std::vector<float>& between = s.shared->between;
  const auto nq = static_cast<size_t>(s.in(G::kQ).size());
  const auto nv = static_cast<size_t>(s.in(G::kQd).size());
  between.resize(2 * (nq + nv));
  for (size_t i = s.following.size() + 1; i-- > 0;) {
    const bool last = i == s.following.size(), first = i == 0;
    const auto array = [&](size_t step, size_t k) {
      return step == 0 ? s.outputs[k].tensor : s.following[step - 1][k];
    };
    float* const to = between.data() + (i % 2) * (nq + nv);
    const float* const carried = between.data() + ((i + 1) % 2) * (nq + nv);
    a.in.q = numbers(first ? s.in(G::kQ) : array(i - 1, 0));
    a.in.qd = numbers(first ? s.in(G::kQd) : array(i - 1, 1));
    a.q_next = numbers(array(i, 0));
    a.qd_next = numbers(array(i, 1));
    a.qdd = numbers(array(i, 4));
    a.branch = numbers(array(i, 5));
    const Tensor* const mine = outputs.data() + 4 * i;
    a.out = {last ? numbers(mine[0]) : carried, last ? numbers(mine[1]) : carried + nq,
             reinterpret_cast<const Transformf*>(numbers(mine[2])),
             reinterpret_cast<const SpatialVectorf*>(numbers(mine[3]))};
    a.gradient.q = first ? q_first : to;
    a.gradient.qd = first ? qd_first : to + nq;
    a.gradient.add = first ? add : add & ~kState;
    with_gravity(s, a, gradients[kGravity].grad, add_gravity, gradients[G::kBodyF].grad,
                 [&](const ArticulationStepVjpArguments& all) {
                   s.shared->trees->vjp(all, *s.model, s.shared->all);
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
  std::vector<LaunchArgument> words;
  add_arguments(s, words);
  for (const size_t i : {4, 5, 0, 1})
    words.push_back(argument(s.outputs[i].name, s.outputs[i].tensor, false));
  for (size_t i = 0; i < 4; ++i)
    words.push_back(argument("gradient of an output", outputs[i], false));
  int64_t add = 0;
  for (size_t i = 0; i < G::kMembers; ++i) {
    words.push_back(argument(s.inputs[i].name, gradients[i].grad, true));
    if (gradients[i].add) add |= int64_t{1} << i;
  }
  words.push_back(number(add));
  words.push_back(writes("workspace", s.workspace));
  words.push_back(number(s.stride));
  for (size_t i = kJointFriction; i < gradients.size(); ++i)
    if (gradients[i].grad.defined() && !gradients[i].add)
      nova::submit_fill(gradients[i].grad.range(), 0.0f);
  const Tensor &gravity = gradients[kGravity].grad, &body_f = gradients[G::kBodyF].grad;
  const bool add_gravity = gradients[kGravity].add, add_body_f = gradients[G::kBodyF].add;
  if (s.shared->runs_on_host()) {
    const auto of = [&](size_t i) {
      return i < gradients.size() ? numbers(gradients[i].grad) : nullptr;
    };
    const ContactGradient more = {of(kJointFriction), of(kMu), of(kRestitution), of(kStiffness),
                                  of(kDamping)};
    return with_gravity(s, to_arguments<ArticulationStepVjpArguments>(words), gravity, add_gravity,
                        body_f, [&](const ArticulationStepVjpArguments& a) {
                          if (prepare_contacts(s, nullptr) || more.joint_friction != nullptr) {
                            const KeptContacts kept = kept_contacts(s);
                            s.shared->pgs->vjp(a, *s.model, contact_rows_of(s), kept.impulses,
                                               kept.friction, s.options, more);
                            return;
                          }
                          s.shared->trees->vjp(a, *s.model, s.shared->all);
                        });
  }
  if (gravity.defined()) {
    words[kGradientWords + G::kBodyF] = writes("gradient of body_f", wrench_memory(s));
    words[kGradientWords + G::kMembers] = number(add & ~(int64_t{1} << G::kBodyF));
  }
  if (s.contacts.defined() && s.shared->launched) {
    const auto to = [&](size_t i) {
      return i < gradients.size() ? argument(s.inputs[i].name, gradients[i].grad, true)
                                  : LaunchArgument();
    };
    s.shared->launched->vjp(
        words, kept_arguments(s, false), s.options, contact_record(s, false),
        {to(kJointFriction), to(kMu), to(kRestitution), to(kStiffness), to(kDamping)});
  } else {
    kernels().vjp.launch(s.shared->device, s.count, words);
  }
  if (gravity.defined())
    kernels().gravity.launch(s.shared->device, 1,
                             gravity_words(s, gravity, add_gravity, body_f, add_body_f));
}

}  // namespace

void submit_vjp(const std::shared_ptr<const Step>& step, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients) {
  if (!works_on_host(*step)) return run_vjp(*step, outputs, gradients);
  std::vector<Tensor> reads = reads_of(*step), results;
  reads.insert(reads.end(), outputs.begin(), outputs.end());
  for (const size_t i : {0, 1, 4, 5}) reads.push_back(step->outputs[i].tensor);
  reads.push_back(step->contacts);
  for (const nova::InputGradient& gradient : gradients)
    if (gradient.grad.defined()) results.push_back(gradient.grad);
  const std::vector<Tensor> out(outputs.begin(), outputs.end());
  const std::vector<nova::InputGradient> to(gradients.begin(), gradients.end());
  nova::capture_host_work({.name = kName,
                           .reads = reads,
                           .results = results,
                           .failure = &step->shared->failure,
                           .run = [step, out, to] { run_vjp(*step, out, to); }});
}

}  // namespace novaphy::diff::detail
