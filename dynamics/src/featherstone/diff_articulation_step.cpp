#include "novaphy/dynamics/featherstone/diff_articulation_step.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

#include "articulation_step.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/nova/host_work.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "pgs_contacts.h"

namespace novaphy::detail {
const char* articulation_kernels_text();
}

namespace novaphy::diff {
namespace {

using nova::Tensor;
constexpr const char* kName = "articulation_step";
constexpr size_t kGradientWords = kArticulationWords + 8;  // before `gradient` of the adjoint
constexpr int32_t kLeastSweeps = 1000;  // at most, where impulses are differentiated
using G = articulation::StepGradient<float>;
// Inputs behind the members of G. Those of shapes only with contacts.
enum MoreInputs : size_t {
  kGravity = G::kMembers,
  kJointFriction,
  kShapeInputs,
  kMu = kShapeInputs,
  kRestitution,
  kStiffness,
  kDamping,
  kInputs
};

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel step{articulation_step, novaphy::detail::articulation_kernels_text};
  DeviceKernel vjp{articulation_step_vjp, novaphy::detail::articulation_kernels_text};
  DeviceKernel gravity{gravity_gradient, novaphy::detail::articulation_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

LaunchArgument argument(const char* name, const Tensor& tensor, bool write) {
  LaunchArgument made;
  if (!tensor.defined()) return made;
  made.word = reinterpret_cast<uint64_t>(tensor.range()->data());
  made.name = name;
  made.range = tensor.range();
  made.read = true;
  made.write = write;
  return made;
}

// Also of an array that may not be written through this handle.
Tensor tensor_of(const Array& array) {
  const nova::Operand operand = nova::operand_of(array);
  const bool is_float = dtype_info(array.dtype()).scalar == Scalar::F32;
  return {
      operand.range, {operand.rows, operand.width}, is_float ? nova::DType::F32 : nova::DType::I32};
}

struct Named {
  const char* name;
  Tensor tensor;
};

}  // namespace

struct ArticulationStep::Shared {
  Shared(const Model& m, const FeatherstoneOptions& o, const char* user)
      : options(o),
        device(m.device()),
        articulations(m, user, Articulations::Devices::All),
        materials(unread_materials(o.contact, user)) {
    const auto count = static_cast<size_t>(articulations.count());
    for (size_t i = 0; i < count; ++i) all.push_back(static_cast<int32_t>(i));
    if (device.is_cpu()) trees.emplace(m, articulations);
    stride = step_workspace(articulations);
    status = DeviceArray<int32_t>(count, device);
    workspace = DeviceArray<float>(count * static_cast<size_t>(stride), device);
  }
  // Where nothing records on the cpu, which steps without launches.
  bool runs_on_host() const { return device.is_cpu() && !nova::current_capture(); }
  FeatherstoneOptions options;
  Device device;
  Articulations articulations;
  std::optional<TreeSteps> trees;  // on the cpu
  std::vector<int32_t> all;        // articulations
  int64_t stride = 0;
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  std::unique_ptr<PgsContacts> pgs;  // made by the first step with contacts
  ContactBranches branches;
  UnreadMaterials materials;
  std::vector<float> between;   // gradients of states between the steps of an operation
  DeviceArray<float> wrenches;  // gradients of body_f, where gravity's is asked for
  std::string failure;          // of a replay
  bool dry = false;             // joints have dry friction, or its gradient is asked for
};

namespace {

// The contacts of a step as it keeps them: numbers per contact, array after array, with the
// impulses behind; indices as the bits of floats. Then how many there are, and the impulses of
// joints' dry friction, a row per dof.
constexpr int64_t kContactNumbers = 16;
struct KeptContacts {
  static int64_t size(int64_t most, int64_t dofs) { return kContactNumbers * most + 1 + dofs; }
  KeptContacts(float* memory, int64_t most)
      : shape0(reinterpret_cast<int32_t*>(memory)),
        shape1(shape0 + most),
        point0(reinterpret_cast<Vec3f*>(memory + 2 * most)),
        point1(point0 + most),
        normal(point1 + most),
        impulses(normal + most),
        margin0(memory + 14 * most),
        margin1(margin0 + most),
        count(reinterpret_cast<int32_t*>(memory + kContactNumbers * most)),
        friction(memory + kContactNumbers * most + 1) {}
  void copy(const ContactRows& c) const {
    const auto n = static_cast<size_t>(c.count);
    *count = c.count;
    std::copy_n(c.shape0, n, shape0);
    std::copy_n(c.shape1, n, shape1);
    std::copy_n(c.point0, n, point0);
    std::copy_n(c.point1, n, point1);
    std::copy_n(c.normal, n, normal);
    std::copy_n(c.margin0, n, margin0);
    std::copy_n(c.margin1, n, margin1);
    std::fill_n(impulses, n, Vec3f{});
  }
  ContactRows rows(bool found) const {
    return {*count, shape0, shape1, nullptr, point0, point1, normal, margin0, margin1, found};
  }
  int32_t *shape0, *shape1;
  Vec3f *point0, *point1, *normal, *impulses;
  float *margin0, *margin1;
  int32_t* count;
  float* friction;
};

// The arrays of contacts that a rollout finds anew whenever its steps run.
struct FoundRows {
  explicit FoundRows(const Contacts& c)
      : most(c.rigid_contact_max()),
        count(c.rigid_contact_count),
        shape0(c.rigid_contact_shape0),
        shape1(c.rigid_contact_shape1),
        point0(c.rigid_contact_point0),
        point1(c.rigid_contact_point1),
        normal(c.rigid_contact_normal),
        margin0(c.rigid_contact_margin0),
        margin1(c.rigid_contact_margin1) {}
  ContactRows rows() const {
    return {std::clamp(*count.data(), 0, most),
            shape0.data(),
            shape1.data(),
            nullptr,
            point0.data(),
            point1.data(),
            normal.data(),
            margin0.data(),
            margin1.data()};
  }
  int32_t most;
  DeviceArray<int32_t> count, shape0, shape1;
  DeviceArray<Vec3f> point0, point1, normal;
  DeviceArray<float> margin0, margin1;
};

}  // namespace

namespace {
// What a step gives: q, qd, body_q, body_qd, and for its adjoint qdd and branch.
using StepOutputs = std::array<Tensor, 6>;
constexpr size_t kMostSteps = 8;  // of an operation: a tape takes 32 outputs
}  // namespace

// The arrays of a step, and of those behind it that are one operation with it: handles, and what
// they are for the tape.
struct ArticulationStep::Step {
  std::shared_ptr<ArticulationStep::Shared> shared;
  std::shared_ptr<const Model> model;
  Tensor contacts = {};                          // KeptContacts; undefined without
  int64_t contact_max = 0;                       // of them
  std::optional<FoundRows> found = {};           // copied whenever the step runs
  bool follow = false;                           // they are of the state that it starts from
  std::optional<DeviceArray<Vec3f>> force = {};  // of the contacts
  bool by_restitution = false;                   // its gradient is asked for
  std::array<Named, kInputs> inputs;             // in the order of StepGradient, MoreInputs
  std::array<Named, 7> values;   // rows, links, dof_parent, X_p, X_c, axis, target_mode
  std::array<Named, 6> outputs;  // q, qd, body_q, body_qd, qdd, branch
  FeatherstoneOptions options;
  float dt = 0.0f;
  int64_t count = 0, stride = 0;
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  ArticulationArguments host = {};          // of the first step, where others follow
  std::vector<StepOutputs> following = {};  // each starts where the one before ended

  // Whether its forward fills `contacts` anew, so that nobody minds who wrote there.
  bool copies_contacts() const { return found.has_value() || contact_max == 0; }
  const Tensor& in(size_t member) const { return inputs[member].tensor; }
};

namespace {

using Step = ArticulationStep::Step;

// The words of ArticulationArguments.
void add_arguments(const Step& s, std::vector<LaunchArgument>& words) {
  const auto value = [&](size_t i) {
    words.push_back(argument(s.values[i].name, s.values[i].tensor, false));
  };
  const auto in = [&](G::Member m) { words.push_back(argument(s.inputs[m].name, s.in(m), false)); };
  for (size_t i = 0; i < 6; ++i) value(i);
  for (const G::Member m : {G::kMass, G::kCom, G::kInertia}) in(m);
  words.push_back(argument(s.inputs[kGravity].name, s.in(kGravity), false));
  value(6);
  for (const G::Member m :
       {G::kTargetQ, G::kTargetQd, G::kTargetKe, G::kTargetKd, G::kDamping, G::kArmature,
        G::kLimitLower, G::kLimitUpper, G::kLimitKe, G::kLimitKd, G::kEffortLimit,
        G::kVelocityLimit, G::kQ, G::kQd, G::kJointF, G::kBodyF})
    in(m);
  words.push_back(number(s.dt));
  words.push_back(number(s.options.angular_damping));
  words.push_back(number(static_cast<int64_t>(s.options.implicit_drives ? 1 : 0)));
}

KeptContacts kept_contacts(const Step& s) {
  return {static_cast<float*>(s.contacts.range()->data()), s.contact_max};
}
ContactRows contact_rows_of(const Step& s) { return kept_contacts(s).rows(s.follow); }

// The words of a launch as the arguments of its kernel.
template <class Arguments>
Arguments to_arguments(const std::vector<LaunchArgument>& words) {
  std::vector<uint64_t> values;
  for (const LaunchArgument& word : words) values.push_back(word.word);
  require(values.size() * sizeof(uint64_t) == sizeof(Arguments), ErrorKind::Runtime, kName,
          ": wrong number of arguments");
  Arguments a;
  std::memcpy(&a, values.data(), sizeof(a));
  return a;
}

// Whether a step has contacts that act; those are then in shared->pgs.
bool prepare_contacts(const Step& s) {
  return s.contacts.defined() && s.shared->pgs->prepare(*s.model, contact_rows_of(s));
}

float* numbers(const Tensor& tensor) {
  return tensor.defined() ? static_cast<float*>(tensor.range()->data()) : nullptr;
}
// What the first step of an operation reads and does, on the host.
ArticulationArguments host_arguments(const Step& s) {
  std::vector<LaunchArgument> words;
  add_arguments(s, words);
  return to_arguments<ArticulationArguments>(words);
}
// The step from the state `from`, or the first one's, into `to`.
void run_host(const Step& s, const ArticulationArguments& in, const StepOutputs* from,
              const StepOutputs& to) {
  ArticulationStepArguments a = {in,
                                 numbers(to[0]),
                                 numbers(to[1]),
                                 reinterpret_cast<Transformf*>(numbers(to[2])),
                                 reinterpret_cast<SpatialVectorf*>(numbers(to[3])),
                                 numbers(to[4]),
                                 numbers(to[5]),
                                 s.shared->status.mutable_data(),
                                 nullptr,
                                 0};
  if (from != nullptr) {
    a.in.q = numbers((*from)[0]);
    a.in.qd = numbers((*from)[1]);
  }
  s.shared->trees->step(a, *s.model, s.shared->all, s.options, nullptr, true);
  for (const Tensor& tensor : to) tensor.range()->mark_written();
}
StepOutputs outputs_of(const Step& s) {
  StepOutputs first;
  for (size_t i = 0; i < first.size(); ++i) first[i] = s.outputs[i].tensor;
  return first;
}
void run_forward(const Step& s) {
  const nova::NoGrad no_grad;
  if (s.contacts.defined() && s.copies_contacts())
    kept_contacts(s).copy(s.found ? s.found->rows() : ContactRows{});
  const bool touches = prepare_contacts(s);
  if (!touches && s.shared->runs_on_host())
    return run_host(s, host_arguments(s), nullptr, outputs_of(s));
  std::vector<LaunchArgument> words;
  add_arguments(s, words);
  for (const Named& out : s.outputs) words.push_back(argument(out.name, out.tensor, true));
  words.push_back(writes_row("status", s.status));
  words.push_back(writes("workspace", s.workspace));
  words.push_back(number(s.stride));
  if (touches) {
    const KeptContacts kept = kept_contacts(s);
    auto a = to_arguments<ArticulationStepArguments>(words);
    a.status = s.shared->status.mutable_data();
    s.shared->pgs->step(a, *s.model, contact_rows_of(s), s.options, nullptr);
    s.shared->pgs->write_impulses(kept.impulses, kept.friction);
    for (const Named& out : s.outputs) out.tensor.range()->mark_written();
    return;
  }
  kernels().step.launch(s.shared->device, s.count, words);
}

// Behind the step as it is recorded: what its contacts say.
void write_forces(const KeptContacts& kept, const DeviceArray<Vec3f>& to, float dt);
void tell_contacts(const Step& s) {
  s.shared->pgs->add_branches(s.shared->branches, s.shared->options, s.by_restitution);
  if (s.force) write_forces(kept_contacts(s), *s.force, s.dt);
}

// What a replay of the step or of its adjoint reads and others may write.
std::vector<Tensor> reads_of(const Step& s) {
  std::vector<Tensor> all;
  for (const Named& in : s.inputs) all.push_back(in.tensor);
  for (size_t i = 3; i < s.values.size(); ++i) all.push_back(s.values[i].tensor);
  return all;
}

// The step now, or in the replays of a capture.
void submit_forward(const std::shared_ptr<const Step>& step, bool tell) {
  const auto run = [step, tell] {
    run_forward(*step);
    if (tell && step->contacts.defined()) tell_contacts(*step);
  };
  if (!nova::current_capture() || !step->contacts.defined()) return run();
  const auto replay = [run, step] {
    run();
    const DeviceArray<int32_t>& status = step->shared->status;
    check_status(*step->model, step->shared->articulations, {status.data(), status.rows()}, kName);
  };
  std::vector<Tensor> results, writes = {step->contacts};
  for (const Named& out : step->outputs) results.push_back(out.tensor);
  if (step->force) writes.push_back(tensor_of(*step->force));
  std::vector<Tensor> reads = reads_of(*step);
  if (step->found) {
    const FoundRows& f = *step->found;
    const Array* const arrays[] = {&f.count,  &f.shape0, &f.shape1,  &f.point0,
                                   &f.point1, &f.normal, &f.margin0, &f.margin1};
    for (const Array* array : arrays) reads.push_back(tensor_of(*array));
  }
  nova::capture_host_work({.name = kName,
                           .reads = reads,
                           .results = results,
                           .writes = writes,
                           .failure = &step->shared->failure,
                           .run = replay});
}

void run_all(const std::shared_ptr<const Step>& step) {
  const Step& s = *step;
  submit_forward(step, false);
  StepOutputs from = outputs_of(s);
  for (const StepOutputs& to : s.following) {
    run_host(s, s.host, &from, to);
    from = to;
  }
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

// The adjoint of some steps, from the last on. The gradients of the states between them stay here.
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
                          if (prepare_contacts(s) || more.joint_friction != nullptr) {
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
  kernels().vjp.launch(s.shared->device, s.count, words);
  if (gravity.defined())
    kernels().gravity.launch(s.shared->device, 1,
                             gravity_words(s, gravity, add_gravity, body_f, add_body_f));
}

// The adjoint of a step now, or in the replays of a capture.
void submit_vjp(const std::shared_ptr<const Step>& step, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients) {
  if (!nova::current_capture() || !step->contacts.defined())
    return run_vjp(*step, outputs, gradients);
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

// Tangents by dual numbers, on the host.
class DualArrays {
 public:
  using D = articulation::Dual<float>;
  // `tangent` undefined: zero.
  template <class T>
  const T* take(const Tensor& values, const Tensor& tangent) {
    std::vector<D>& to = arrays_.emplace_back(static_cast<size_t>(values.size()));
    const float* x = values.data<float>();
    const float* t = tangent.defined() ? tangent.data<float>() : nullptr;
    for (size_t i = 0; i < to.size(); ++i) to[i] = {x[i], t ? t[i] : 0.0f};
    return reinterpret_cast<const T*>(to.data());
  }
  template <class T>
  T* make(const Tensor& like) {
    return const_cast<T*>(take<T>(like, {}));
  }

 private:
  std::vector<std::vector<D>> arrays_;
};

void write_tangent(const Tensor& to, const articulation::Dual<float>* values) {
  if (!to.defined()) return;
  auto* t = static_cast<float*>(to.range()->data());
  for (int64_t i = 0; i < to.size(); ++i) t[i] = values[i].tangent;
}

void run_jvp(const Step& s, const StepOutputs* from, const StepOutputs& to,
             std::span<const Tensor> t, std::span<const Tensor> tangents) {
  using D = articulation::Dual<float>;
  DualArrays duals;
  const auto in = [&](G::Member m) { return duals.take<D>(s.in(m), t[m]); };
  const auto* target_mode = s.values[6].tensor.data<int32_t>();
  const articulation::StepInputs<D> inputs = {
      duals.take<D>(from ? (*from)[0] : s.in(G::kQ), t[G::kQ]),
      duals.take<D>(from ? (*from)[1] : s.in(G::kQd), t[G::kQd]),
      in(G::kJointF),
      duals.take<SpatialVector<D>>(s.in(G::kBodyF), t[G::kBodyF]),
      {target_mode, in(G::kTargetQ), in(G::kTargetQd), in(G::kTargetKe), in(G::kTargetKd),
       in(G::kDamping), in(G::kArmature), in(G::kLimitLower), in(G::kLimitUpper), in(G::kLimitKe),
       in(G::kLimitKd), in(G::kEffortLimit), in(G::kVelocityLimit)}};
  articulation::Tree<D> tree;
  tree.X_p = duals.take<Transform<D>>(s.values[3].tensor, {});
  tree.X_c = duals.take<Transform<D>>(s.values[4].tensor, {});
  tree.axis = duals.take<Vec3<D>>(s.values[5].tensor, {});
  tree.mass = in(G::kMass);
  tree.com = duals.take<Vec3<D>>(s.in(G::kCom), t[G::kCom]);
  tree.inertia = duals.take<Mat33<D>>(s.in(G::kInertia), t[G::kInertia]);
  const auto* gravity = duals.take<Vec3<D>>(s.in(kGravity), t[kGravity]);
  D* const q = duals.make<D>(to[0]);
  D* const qd = duals.make<D>(to[1]);
  auto* const body_q = duals.make<Transform<D>>(to[2]);
  auto* const body_qd = duals.make<SpatialVector<D>>(to[3]);
  const articulation::StepOptions<D> options = {D(s.dt), D(s.options.angular_damping),
                                                s.options.implicit_drives};
  const auto* rows = reinterpret_cast<const ArticulationRows*>(s.values[0].tensor.data<int32_t>());
  const auto* links =
      reinterpret_cast<const articulation::Link*>(s.values[1].tensor.data<int32_t>());
  const auto count = static_cast<size_t>(s.count);
  std::vector<std::vector<uint64_t>> memory(count);
  std::vector<articulation::Tree<D>> all(count, tree);
  std::vector<articulation::Workspace<D>> workspaces(count);
  std::vector<char> moves(count);
  for (size_t i = 0; i < count; ++i) {
    articulation::Tree<D>& of = all[i];
    of.link_count = rows[i].link_count;
    of.dof_count = rows[i].dof_count;
    of.links = links + rows[i].first_link;
    of.dof_parent = s.values[2].tensor.data<int32_t>() + rows[i].first_dof;
    of.first_dof = rows[i].first_dof;
    of.gravity = gravity[rows[i].world];
    memory[i].resize(
        static_cast<size_t>(articulation::workspace_bytes<D>(of.link_count, of.dof_count) / 8 + 1));
    workspaces[i] = articulation::make_workspace<D>(memory[i].data(), of.link_count, of.dof_count);
    moves[i] = articulation::accelerate(of, inputs, options, workspaces[i]) < 0;
    if (moves[i]) articulation::free_rates(of, inputs, options, workspaces[i]);
  }
  const bool all_move = std::all_of(moves.begin(), moves.end(), [](char m) { return m != 0; });
  if (all_move && (prepare_contacts(s) || t[kJointFriction].defined())) {
    const auto of = [&](size_t i) {
      return s.in(i).defined() ? duals.take<D>(s.in(i), i < t.size() ? t[i] : Tensor()) : nullptr;
    };
    const ContactDuals more = {of(kJointFriction), of(kMu), of(kRestitution), of(kStiffness),
                               of(kDamping)};
    const KeptContacts kept = kept_contacts(s);
    s.shared->pgs->jvp(all, inputs.qd, workspaces, contact_rows_of(s), kept.impulses, kept.friction,
                       s.options, more, s.dt);
  }
  for (size_t i = 0; i < count; ++i) {
    if (!moves[i]) continue;
    articulation::clamp_rates(all[i], inputs, workspaces[i]);
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
    inputs[G::kQ] = out[0];
    inputs[G::kQd] = out[1];
    from = to;
  }
  for (size_t i = 4 * (s.following.size() + 1); i < tangents.size(); ++i)
    if (tangents[i].defined())
      std::fill_n(static_cast<float*>(tangents[i].range()->data()), tangents[i].size(), 0.0f);
}

// The same now, or in the replays of a capture.
void submit_jvp(const std::shared_ptr<const Step>& step, std::span<const Tensor> inputs,
                std::span<const Tensor> outputs) {
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

// rigid_contact_force from the impulses of a step.
void write_forces(const KeptContacts& kept, const DeviceArray<Vec3f>& to, float dt) {
  DeviceArray<Vec3f> forces = to;
  Vec3f* const force = forces.mutable_data();
  for (int32_t i = 0; i < *kept.count; ++i) {
    const articulation::ContactFrame<float> frame = articulation::contact_frame(kept.normal[i]);
    const Vec3f& x = kept.impulses[i];
    force[i] = (frame.axes[0] * x.x + (frame.axes[1] * x.y + frame.axes[2] * x.z)) * (1.0f / dt);
  }
}

nova::CustomOp make_op(const std::shared_ptr<const Step>& step) {
  nova::CustomOp op{.name = kName, .inputs = {}, .outputs = {}, .vjp = nullptr};
  for (const Named& in : step->inputs)
    if (in.tensor.defined()) op.inputs.push_back(in.tensor);
  op.reads = op.inputs;
  for (const Named& value : step->values) op.reads.push_back(value.tensor);
  // Of a single step, which may be run again from a checkpoint, qdd and branch are outputs too.
  const bool single = step->following.empty();
  const auto add_step = [&](const StepOutputs& out) {
    op.outputs.insert(op.outputs.end(), out.begin(), out.begin() + (single ? 6 : 4));
    for (const size_t i : {0, 1, 4, 5}) op.reads.push_back(out[i]);
  };
  add_step(outputs_of(*step));
  for (const StepOutputs& out : step->following) add_step(out);
  // Read too, but nobody else has it, and the other steps of a rollout keep the same there.
  if (step->contacts.defined()) op.writes.push_back(step->contacts);
  op.writes.push_back(tensor_of(step->status));
  if (step->stride > 0) op.writes.push_back(tensor_of(step->workspace));
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> inputs) {
    if (step->following.empty())
      submit_vjp(step, outputs, inputs);
    else
      run_vjp_of_steps(*step, outputs, inputs);
  };
  op.forward = [step] { run_all(step); };
  op.jvp = [step](std::span<const Tensor> inputs, std::span<const Tensor> outputs) {
    require(step->shared->device.is_cpu(), ErrorKind::NotImplemented,
            "articulation_step: forward derivatives are there on the cpu, got ",
            step->shared->device.str());
    submit_jvp(step, inputs, outputs);
  };
  return op;
}

}  // namespace

ArticulationStep::ArticulationStep(const Model& model, const FeatherstoneOptions& options,
                                   const char* user) {
  check_featherstone_model(model, options, user);
  require(model.joint_dof_count() > 0, ErrorKind::Value, user,
          ": model: expected joints with degrees of freedom, got none");
  require(options.contact != ArticulationContact::Penalty, ErrorKind::NotImplemented, user,
          ": contact: expected pgs or none, penalty contacts have no gradient");
  FeatherstoneOptions converged = options;
  converged.warm_start = false;
  converged.pgs_iterations = std::max(options.pgs_iterations, kLeastSweeps);
  shared_ = std::make_shared<Shared>(model, converged, user);
}
ArticulationStep::~ArticulationStep() = default;
ArticulationStep::ArticulationStep(ArticulationStep&&) noexcept = default;
ArticulationStep& ArticulationStep::operator=(ArticulationStep&&) noexcept = default;

std::vector<ScratchSpec> ArticulationStep::scratch(const Model& model, int32_t contact_max) const {
  const auto dofs = static_cast<size_t>(model.joint_dof_count());
  std::vector<ScratchSpec> specs = {{novaphy::DType::float32, dofs, 1},
                                    {novaphy::DType::float32, dofs, 1}};
  if (contact_max > 0 || shared_->dry)
    specs.push_back({novaphy::DType::float32,
                     static_cast<size_t>(KeptContacts::size(contact_max, model.joint_dof_count())),
                     1});
  return specs;
}

void ArticulationStep::begin(const Model& model, const Control* control, const char* function) {
  if (!shared_->failure.empty())
    fail(ErrorKind::Runtime, function,
         ": a replay of a captured step failed, its results are NaN: ",
         std::exchange(shared_->failure, {}));
  const bool on_cpu = shared_->device.is_cpu();
  shared_->articulations.check_values(model, control, on_cpu, function);
  const nova::Tape* const tape = nova::Tape::active();
  shared_->dry = tape != nullptr && tape->carries_gradient(*model.joint_friction.range());
  if (on_cpu) {
    depend_on_modes(model, control);
    const float* const friction = model.joint_friction.data();
    shared_->dry = shared_->dry || std::any_of(friction, friction + model.joint_dof_count(),
                                               [](float f) { return f > 0.0f; });
    return;
  }
  require(!shared_->dry, ErrorKind::NotImplemented, function,
          ": model.joint_friction: expected no gradient of it on ", shared_->device.str());
  depend_on_values(model, control);
}

void ArticulationStep::record(const Model& m, const SimState& in, SimState& out,
                              const Control* control, const Contacts* contacts, FoundContacts found,
                              const nova::Operand& body_f, float dt, StepScratch scratch,
                              bool join) {
  if (join && pending_ && joins(m, in, out, control, body_f, dt, scratch)) return;
  flush();
  const auto view = [](const char* name, const Array& array) {
    return Named{name, tensor_of(array)};
  };
  const Articulations& a = shared_->articulations;
  const auto& joint_f = control ? control->joint_f : m.joint_f;
  const auto& target_q = control ? control->joint_target_q : m.joint_target_q;
  const auto& target_qd = control ? control->joint_target_qd : m.joint_target_qd;
  const bool touching = contacts != nullptr && contacts->rigid_contact_max() > 0;
  require(!touching || shared_->device.is_cpu(), ErrorKind::NotImplemented,
          "DiffFeatherstoneSolver: contacts: expected none on ", shared_->device.str(),
          " (contacts of articulations are solved on the cpu)");
  auto step = std::make_shared<Step>(Step{
      shared_,
      m.shared_from_this(),
      touching || shared_->dry ? tensor_of(scratch[2]) : Tensor(),
      touching ? contacts->rigid_contact_max() : 0,
      touching && (found == FoundContacts::Always || nova::current_capture() != nullptr)
          ? std::optional<FoundRows>(*contacts)
          : std::nullopt,
      found != FoundContacts::Before,
      touching ? std::optional<DeviceArray<Vec3f>>(contacts->rigid_contact_force) : std::nullopt,
      nova::Tape::active() != nullptr &&
          nova::Tape::active()->carries_gradient(*m.shape_material_restitution.range()),
      {view("joint_q", in.joint_q),
       view("joint_qd", in.joint_qd),
       view("joint_f", joint_f),
       {"body_f", {body_f.range, {body_f.rows, body_f.width}, nova::DType::F32}},
       view("joint_target_q", target_q),
       view("joint_target_qd", target_qd),
       view("joint_target_ke", m.joint_target_ke),
       view("joint_target_kd", m.joint_target_kd),
       view("joint_damping", m.joint_damping),
       view("joint_armature", m.joint_armature),
       view("joint_limit_lower", m.joint_limit_lower),
       view("joint_limit_upper", m.joint_limit_upper),
       view("joint_limit_ke", m.joint_limit_ke),
       view("joint_limit_kd", m.joint_limit_kd),
       view("joint_effort_limit", m.joint_effort_limit),
       view("joint_velocity_limit", m.joint_velocity_limit),
       view("body_mass", m.body_mass),
       view("body_com", m.body_com),
       view("body_inertia", m.body_inertia),
       view("gravity", m.gravity),
       view("joint_friction", m.joint_friction),
       touching ? view("shape_material_mu", m.shape_material_mu) : Named{},
       touching ? view("shape_material_restitution", m.shape_material_restitution) : Named{},
       touching ? view("shape_material_ke", m.shape_material_ke) : Named{},
       touching ? view("shape_material_kd", m.shape_material_kd) : Named{}},
      {view("rows", a.rows()), view("links", a.links()), view("dof_parent", a.dof_parent()),
       view("joint_X_p", m.joint_X_p), view("joint_X_c", m.joint_X_c),
       view("joint_axis", m.joint_axis), view("joint_target_mode", m.joint_target_mode)},
      {view("joint_q", out.joint_q), view("joint_qd", out.joint_qd), view("body_q", out.body_q),
       view("body_qd", out.body_qd), view("qdd", scratch[0]), view("branch", scratch[1])},
      shared_->options,
      dt,
      a.count(),
      shared_->stride,
      shared_->status,
      shared_->workspace});
  if (touching) shared_->materials.check(m);
  const bool solves = step->contacts.defined();
  if (solves) {
    if (!shared_->pgs) shared_->pgs = std::make_unique<PgsContacts>(m, a);
    if (!step->copies_contacts()) kept_contacts(*step).copy(contact_rows(contacts));
  }
  submit_forward(step, true);
  if (nova::Tape::active() == nullptr) return;
  pending_ = std::move(step);
  if (!join || solves || !shared_->runs_on_host() || nova::current_capture()) return flush();
  pending_->host = host_arguments(*pending_);
}

// Whether the step is one operation with those that wait to be recorded; then it has run.
bool ArticulationStep::joins(const Model& m, const SimState& in, SimState& out,
                             const Control* control, const nova::Operand& body_f, float dt,
                             StepScratch scratch) {
  Step& first = *pending_;
  const auto& joint_f = control ? control->joint_f : m.joint_f;
  const auto& target_q = control ? control->joint_target_q : m.joint_target_q;
  const auto& target_qd = control ? control->joint_target_qd : m.joint_target_qd;
  const auto same = [&](G::Member member, const std::shared_ptr<Range>& range) {
    return first.in(member).range()->data() == range->data();
  };
  const StepOutputs from = first.following.empty() ? outputs_of(first) : first.following.back();
  if (first.following.size() + 1 == kMostSteps || first.dt != dt ||
      from[0].range()->data() != in.joint_q.range()->data() ||
      from[1].range()->data() != in.joint_qd.range()->data() ||
      !same(G::kJointF, joint_f.range()) || !same(G::kTargetQ, target_q.range()) ||
      !same(G::kTargetQd, target_qd.range()) || !same(G::kBodyF, body_f.range))
    return false;
  const StepOutputs to = {tensor_of(out.joint_q), tensor_of(out.joint_qd), tensor_of(out.body_q),
                          tensor_of(out.body_qd), tensor_of(scratch[0]),   tensor_of(scratch[1])};
  run_host(first, first.host, &from, to);
  first.following.push_back(to);
  return true;
}

void ArticulationStep::flush() {
  if (!pending_) return;
  const std::shared_ptr<const Step> step = std::move(pending_);
  pending_ = nullptr;
  if (nova::Tape* tape = nova::Tape::active()) tape->record_custom(make_op(step));
}
void ArticulationStep::forget() { pending_ = nullptr; }

const ContactBranches& ArticulationStep::branches() const { return shared_->branches; }
void ArticulationStep::clear_branches() { shared_->branches = {}; }

void ArticulationStep::check(const Model& model, const char* function) const {
  const OnHost<int32_t> status(shared_->status);
  check_status(model, shared_->articulations, {status.data(), status.size()}, function);
}

}  // namespace novaphy::diff
