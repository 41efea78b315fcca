// The arrays of a step of articulations, and its forward.
#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/nova/host_work.h"

namespace novaphy::diff::detail {
namespace {

// Never destroyed: recordings refer to it.
const DeviceKernel& step_kernel() {
  static const auto& kernel =
      *new DeviceKernel{articulation_step, novaphy::detail::articulation_kernels_text};
  return kernel;
}

}  // namespace

// Also of an array that may not be written through this handle.
Tensor tensor_of(const Array& array) {
  const nova::Operand operand = nova::operand_of(array);
  const bool is_float = dtype_info(array.dtype()).scalar == Scalar::F32;
  return {
      operand.range, {operand.rows, operand.width}, is_float ? nova::DType::F32 : nova::DType::I32};
}

void add_arguments(const Step& s, std::vector<LaunchArgument>& words) {
  for (size_t i = 0; i < kGradientArrays; ++i)
    words.push_back(argument(s.inputs[i].name, s.in(i), false));
  for (const Named& value : s.values) words.push_back(argument(value.name, value.tensor, false));
  words.push_back(number(s.dt));
  words.push_back(number(s.options.angular_damping));
  words.push_back(number(static_cast<int64_t>(s.options.implicit_drives ? 1 : 0)));
}

ContactRowArguments kept_arguments(const Step& s, bool write) {
  const auto part = [&](const char* name, int64_t first) {
    LaunchArgument a = argument(name, s.contacts, write);
    a.read = !write;
    a.word += static_cast<uint64_t>(first) * sizeof(float);
    return a;
  };
  const int64_t most = s.contact_max;
  ContactRowArguments rows;
  rows.shape0 = part("contact_shape0", 0);
  rows.shape1 = part("contact_shape1", most);
  rows.point0 = part("contact_point0", 2 * most);
  rows.point1 = part("contact_point1", 5 * most);
  rows.normal = part("contact_normal", 8 * most);
  rows.margin0 = part("contact_margin0", 14 * most);
  rows.margin1 = part("contact_margin1", 15 * most);
  rows.count = part("contact_count", kContactNumbers * most);
  rows.most = most;
  return rows;
}
ContactRecord contact_record(const Step& s, bool write) {
  const auto part = [&](const char* name, int64_t first) {
    LaunchArgument a = argument(name, s.contacts, write);
    a.word += static_cast<uint64_t>(first) * sizeof(float);
    return a;
  };
  ContactRecord record;
  record.impulses = part("impulses", 11 * s.contact_max);
  record.friction = part("friction_impulses", kContactNumbers * s.contact_max + 1 + kFarNumbers);
  record.found = s.follow;
  record.by_restitution = s.by_restitution;
  record.continues = s.continues;
  record.dry = s.dry;
  record.records = true;
  return record;
}
bool works_on_host(const Step& s) {
  return nova::current_capture() && s.contacts.defined() && s.shared->device.is_cpu();
}

void require_converged(const Step& s, const char* what) {
  if (!s.contacts.defined() || s.shared->allow_unconverged) return;
  std::string of;
  if (s.shared->device.is_cpu()) {
    const KeptContacts kept = kept_contacts(s);
    if (kept.far->sweeps == 0) return;
    of = std::to_string(s.number) + ": " +
         describe(*kept.far, *s.model, s.shared->articulations, kept.rows(false));
  } else if (*s.far) {
    of = std::to_string(s.number) + ", or one near it";
  } else {
    return;
  }
  fail(ErrorKind::Runtime, what,
       ": contacts and dry friction of joints have not converged in step ", of,
       ". Its gradient may be any number: shorten dt, raise pgs_iterations, bring masses that "
       "touch nearer to each other, or pass allow_unconverged=True");
}

bool prepare_contacts(const Step& s, const ArticulationArguments* from) {
  return s.contacts.defined() && s.shared->pgs->prepare(*s.model, contact_rows_of(s), from);
}

ArticulationArguments host_arguments(const Step& s) {
  return arguments_of<float>(s, [](const Tensor& values, int32_t) { return numbers(values); });
}

namespace {

ArticulationStepArguments host_step(const Step& s, const ArticulationArguments& in,
                                    const StepOutputs& to) {
  return {.in = in,
          .q_next = numbers(to[0]),
          .qd_next = numbers(to[1]),
          .body_q = reinterpret_cast<Transformf*>(numbers(to[2])),
          .body_qd = reinterpret_cast<SpatialVectorf*>(numbers(to[3])),
          .qdd = numbers(to[4]),
          .branch = numbers(to[5]),
          .status = s.shared->status.mutable_data(),
          .workspace = nullptr,
          .stride = 0};
}

}  // namespace

void run_host(const Step& s, const ArticulationArguments& in, const StepOutputs* from,
              const StepOutputs& to) {
  ArticulationStepArguments a = host_step(s, in, to);
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

namespace {

void copy_found(const Step& s) {
  if (s.contacts.defined() && s.copies_contacts())
    kept_contacts(s).copy(s.found ? s.found->rows() : ContactRows{});
}

// With contacts on a device. `tell`: notes its branches and writes the forces of its contacts.
void launch_contacts(const Step& s, std::vector<LaunchArgument> words, bool tell) {
  LaunchedContacts& launched = *s.shared->launched;
  if (s.copies_contacts())
    launched.copy(s.found ? s.found->arguments() : ContactRowArguments(), kept_arguments(s, true));
  ContactRowArguments rows = kept_arguments(s, false);
  ContactRecord record = contact_record(s, true);
  if (tell && s.force) rows.force = writes("rigid_contact_force", *s.force);
  if (tell && s.point_id) rows.point_id = reads("rigid_contact_point_id", *s.point_id);
  record.notes = tell;
  launched.step(std::move(words), rows, s.options, s.dt, record);
}

void run_forward(const Step& s, bool tell) {
  const nova::NoGrad no_grad;
  const bool on_host = s.shared->device.is_cpu();
  if (on_host) {
    copy_found(s);
    const ArticulationArguments in = host_arguments(s);
    const bool touches = prepare_contacts(s, &in);
    if (s.contacts.defined()) *kept_contacts(s).far = {};
    if (!touches && s.shared->runs_on_host()) return run_host(s, in, nullptr, outputs_of(s));
    if (touches) {
      const KeptContacts kept = kept_contacts(s);
      s.shared->pgs->step(host_step(s, in, outputs_of(s)), *s.model, contact_rows_of(s), s.options,
                          nullptr);
      s.shared->pgs->write_impulses(kept.impulses, kept.friction);
      *kept.far = s.shared->pgs->far_island();
      for (const Named& out : s.outputs) out.tensor.range()->mark_written();
      return;
    }
  }
  std::vector<LaunchArgument> words;
  add_arguments(s, words);
  for (const Named& out : s.outputs) words.push_back(argument(out.name, out.tensor, true));
  words.push_back(writes_row("status", s.status));
  words.push_back(writes("workspace", s.workspace));
  words.push_back(number(s.stride));
  if (!on_host && s.contacts.defined()) return launch_contacts(s, std::move(words), tell);
  step_kernel().launch(s.shared->device, s.count, words);
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

// Behind the step as it is recorded: what its contacts say.
void tell_contacts(const Step& s) {
  const ContactRows rows =
      kept_contacts(s).rows(s.follow, s.point_id ? s.point_id->data() : nullptr);
  if (s.motion)
    s.motion->found = s.shared->pgs->events(rows, s.options, numbers(s.in(kAt.qd)), s.continues);
  s.shared->pgs->add_branches(s.shared->branches, rows, s.shared->options, s.by_restitution,
                              s.continues);
  if (s.force) write_forces(kept_contacts(s), *s.force, s.dt);
}

}  // namespace

std::vector<Tensor> reads_of(const Step& s) {
  std::vector<Tensor> all;
  for (const Named& in : s.inputs) all.push_back(in.tensor);
  for (size_t i = kFrameP; i <= kTargetMode; ++i) all.push_back(s.values[i].tensor);
  return all;
}

void submit_forward(const std::shared_ptr<const Step>& step, bool tell) {
  const auto run = [step, tell] {
    const bool on_host = step->shared->device.is_cpu();
    run_forward(*step, tell);
    if (tell && step->contacts.defined() && on_host) tell_contacts(*step);
  };
  if (!works_on_host(*step)) return run();
  const auto replay = [run, step] {
    run();
    const DeviceArray<int32_t>& status = step->shared->status;
    check_status(*step->model, step->shared->articulations, {status.data(), status.rows()}, kName);
  };
  std::vector<Tensor> results, writes = {step->contacts};
  for (const Named& out : step->outputs) results.push_back(out.tensor);
  if (step->force) writes.push_back(tensor_of(*step->force));
  std::vector<Tensor> reads = reads_of(*step);
  if (step->point_id) reads.push_back(tensor_of(*step->point_id));
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

}  // namespace novaphy::diff::detail
