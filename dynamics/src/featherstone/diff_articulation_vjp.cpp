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
  const auto numbers_of = static_cast<size_t>(s.in(kAt.body_f).size());
  DeviceArray<float>& memory = s.shared->wrenches;
  if (memory.size() != numbers_of) {
    const Unobserved unobserved;
    memory = DeviceArray<float>(numbers_of, s.shared->device);
  }
  return memory;
}
std::vector<LaunchArgument> gravity_words(const Step& s, const Tensor& gravity, bool add_gravity,
                                          const Tensor& body_f, bool add_body_f) {
  return {argument("rows", s.values[kRows].tensor, false),
          argument("links", s.values[kLinks].tensor, false),
          argument("body_mass", s.in(kAt.mass), false),
          reads("gradient of body_f", s.shared->wrenches),
          argument("gradient of gravity", gravity, true),
          argument("gradient of body_f", body_f, true),
          number(s.count),
          number(s.in(kAt.body_f).size() / 6),
          number(gravity.size() / 3),
          number(int64_t{add_gravity}),
          number(int64_t{add_body_f})};
}
// Calls `adjoint` with the arguments, and gives gravity its gradient (undefined: nobody wants it).
template <class Adjoint>
void with_gravity(const Step& s, ArticulationStepVjpArguments a, const Tensor& gravity, bool add,
                  const Tensor& body_f, const Adjoint& adjoint) {
  if (!gravity.defined()) return adjoint(a);
  constexpr int32_t kWrench = 1 << kAt.body_f;
  const bool add_body_f = (a.gradient.add & kWrench) != 0;
  a.gradient.body_f = reinterpret_cast<SpatialVectorf*>(wrench_memory(s).mutable_data());
  a.gradient.add &= ~kWrench;
  adjoint(a);
  const GravityGradientArguments of_gravity = {
      .rows = a.in.rows,
      .links = a.in.links,
      .mass = a.in.mass,
      .wrenches = a.gradient.body_f,
      .gravity = reinterpret_cast<Vec3f*>(numbers(gravity)),
      .body_f = reinterpret_cast<SpatialVectorf*>(numbers(body_f)),
      .count = s.count,
      .bodies = s.in(kAt.body_f).size() / 6,
      .worlds = gravity.size() / 3,
      .add_gravity = add,
      .add_body_f = add_body_f};
  gravity_gradient_row(of_gravity, 0, 1);
}

// What the adjoint of the first step reads and writes, but gravity's gradient, which with_gravity
// writes.
ArticulationStepVjpArguments host_vjp(const Step& s, const ArticulationArguments& in,
                                      std::span<const nova::InputGradient> gradients) {
  ArticulationStepVjpArguments a = {};
  a.in = in;
  a.qdd = numbers(s.outputs[4].tensor);
  a.branch = numbers(s.outputs[5].tensor);
  a.q_next = numbers(s.outputs[0].tensor);
  a.qd_next = numbers(s.outputs[1].tensor);
  float* to[kGradientArrays];
  for (size_t i = 0; i < kGradientArrays; ++i) {
    to[i] = numbers(gradients[i].grad);
    if (gradients[i].add) a.gradient.add |= int32_t{1} << i;
  }
  point_gradient_arrays(a.gradient, to);
  a.gradient.gravity = nullptr;
  a.workspace = const_cast<float*>(s.workspace.data());
  a.stride = s.stride;
  return a;
}
articulation::StepOutputGradient<float> output_gradient(const Tensor* of) {
  return {numbers(of[0]), numbers(of[1]), reinterpret_cast<const Transformf*>(numbers(of[2])),
          reinterpret_cast<const SpatialVectorf*>(numbers(of[3]))};
}

}  // namespace

void run_vjp_of_steps(const Step& s, std::span<const Tensor> outputs,
                      std::span<const nova::InputGradient> gradients) {
  require(!nova::current_capture(), ErrorKind::NotImplemented,
          "articulation_step: backward inside a ScopedCapture of a rollout outside of it is not "
          "there");
  ArticulationStepVjpArguments a = host_vjp(s, s.host, gradients);
  int32_t add = a.gradient.add;
  bool add_gravity = gradients[kAt.gravity].add;
  constexpr int32_t kState = 1 << kAt.q | 1 << kAt.qd;
  float *const q_first = a.gradient.q, *const qd_first = a.gradient.qd;
  std::vector<float>& between = s.shared->between;
  const auto nq = static_cast<size_t>(s.in(kAt.q).size());
  const auto nv = static_cast<size_t>(s.in(kAt.qd).size());
  between.resize(2 * (nq + nv));
  for (size_t i = s.following.size() + 1; i-- > 0;) {
    const bool last = i == s.following.size(), first = i == 0;
    const auto array = [&](size_t step, size_t k) {
      return step == 0 ? s.outputs[k].tensor : s.following[step - 1][k];
    };
    float* const to = between.data() + (i % 2) * (nq + nv);
    const float* const carried = between.data() + ((i + 1) % 2) * (nq + nv);
    a.in.q = numbers(first ? s.in(kAt.q) : array(i - 1, 0));
    a.in.qd = numbers(first ? s.in(kAt.qd) : array(i - 1, 1));
    a.q_next = numbers(array(i, 0));
    a.qd_next = numbers(array(i, 1));
    a.qdd = numbers(array(i, 4));
    a.branch = numbers(array(i, 5));
    const Tensor* const mine = outputs.data() + 4 * i;
    a.out = output_gradient(mine);
    if (!last) {
      a.out.q = carried;
      a.out.qd = carried + nq;
    }
    a.gradient.q = first ? q_first : to;
    a.gradient.qd = first ? qd_first : to + nq;
    a.gradient.add = first ? add : add & ~kState;
    with_gravity(s, a, gradients[kAt.gravity].grad, add_gravity, gradients[kAt.body_f].grad,
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

void launch_vjp(const Step& s, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients) {
  const Tensor &gravity = gradients[kAt.gravity].grad, &body_f = gradients[kAt.body_f].grad;
  std::vector<LaunchArgument> words;
  add_arguments(s, words);
  for (const size_t i : {4, 5, 0, 1})
    words.push_back(argument(s.outputs[i].name, s.outputs[i].tensor, false));
  for (size_t i = 0; i < 4; ++i)
    words.push_back(argument("gradient of an output", outputs[i], false));
  int64_t add = 0;
  for (size_t i = 0; i < kGradientArrays; ++i) {
    const Tensor& to =
        i == kAt.gravity ? Tensor() : gradients[i].grad;  // gravity_gradient writes that
    words.push_back(argument(s.inputs[i].name, to, true));
    if (gradients[i].add) add |= int64_t{1} << i;
  }
  words.push_back(number(add));
  words.push_back(writes("workspace", s.workspace));
  words.push_back(number(s.stride));
  if (gravity.defined()) {
    words[kGradientWords + kAt.body_f] = writes("gradient of body_f", wrench_memory(s));
    words[kGradientWords + kGradientArrays] = number(add & ~(int64_t{1} << kAt.body_f));
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
    kernels().gravity.launch(
        s.shared->device, 1,
        gravity_words(s, gravity, gradients[kAt.gravity].add, body_f, gradients[kAt.body_f].add));
}

void run_vjp(const Step& s, std::span<const Tensor> outputs,
             std::span<const nova::InputGradient> gradients) {
  const nova::NoGrad no_grad;
  require_converged(s, "backward");
  for (size_t i = kJointFriction; i < gradients.size(); ++i)
    if (gradients[i].grad.defined() && !gradients[i].add)
      nova::submit_fill(gradients[i].grad.range(), 0.0f);
  if (!s.shared->runs_on_host()) return launch_vjp(s, outputs, gradients);
  const auto of = [&](size_t i) {
    return i < gradients.size() ? numbers(gradients[i].grad) : nullptr;
  };
  const ContactGradient more = {of(kJointFriction), of(kMu), of(kRestitution), of(kStiffness),
                                of(kDamping)};
  ArticulationStepVjpArguments all = host_vjp(s, host_arguments(s), gradients);
  all.out = output_gradient(outputs.data());
  with_gravity(s, all, gradients[kAt.gravity].grad, gradients[kAt.gravity].add,
               gradients[kAt.body_f].grad, [&](const ArticulationStepVjpArguments& a) {
                 if (prepare_contacts(s, nullptr) || more.joint_friction != nullptr) {
                   const KeptContacts kept = kept_contacts(s);
                   s.shared->pgs->vjp(a, *s.model, contact_rows_of(s), kept.impulses, kept.friction,
                                      s.options, more);
                   return;
                 }
                 s.shared->trees->vjp(a, *s.model, s.shared->all);
               });
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
