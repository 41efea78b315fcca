// The arrays of a step of articulations, and the forward step.
#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/nova/host_work.h"

namespace novaphy::diff::detail {

// Returns the tensor of an array, even if this handle is read-only.
Tensor tensor_of(const Array& array) {
  const nova::Operand operand = nova::operand_of(array);
  const bool is_float = dtype_info(array.dtype()).scalar == Scalar::F32;
  return {
      operand.range, {operand.rows, operand.width}, is_float ? nova::DType::F32 : nova::DType::I32};
}

// Returns a part of the memory of stored contacts: as host memory if nothing records the launches.
Untyped part_of(const Step& s, int64_t first, int64_t count) {
  if (s.shared->runs_on_host()) return Untyped(numbers(s.contacts) + first);
  const auto bytes = [](int64_t n) { return static_cast<size_t>(n) * sizeof(float); };
  return nova::part_of(s.contacts.range(), bytes(first), bytes(count));
}

ContactArguments kept_arguments(const Step& s) {
  const int64_t most = s.contact_max;
  return {.at = {.shape0 = part_of(s, 0, most),
                 .shape1 = part_of(s, most, most),
                 .point0 = part_of(s, 2 * most, 3 * most),
                 .point1 = part_of(s, 5 * most, 3 * most),
                 .normal = part_of(s, 8 * most, 3 * most),
                 .margin0 = part_of(s, 14 * most, most),
                 .margin1 = part_of(s, 15 * most, most)},
          .count = part_of(s, kContactNumbers * most, 1),
          .most = most};
}
ContactRecord contact_record(const Step& s) {
  const int64_t most = s.contact_max, friction = kContactNumbers * most + 1 + kFarNumbers;
  return {.impulses = part_of(s, 11 * most, 3 * most),
          .friction = part_of(s, friction, s.contacts.size() - friction),
          .found = s.follow,
          .by_restitution = s.by_restitution,
          .continues = s.continues,
          .dry = s.dry,
          .records = true};
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
         describe(*kept.far, *s.model, s.shared->articulations, kept.shape0, kept.shape1);
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

void watch_convergence(const std::shared_ptr<const Step>& step, std::span<const Tensor> results,
                       const char* what) {
  if (!works_on_host(*step) || step->shared->allow_unconverged) return;
  nova::capture_host_work({.name = kName,
                           .reads = {step->contacts},
                           .results = {results.begin(), results.end()},
                           .failure = &step->shared->failure,
                           .run = [step, what] { require_converged(*step, what); }});
}

bool acts(const Step& s, const Tensor& joint_friction) {
  if (!s.contacts.defined()) return false;
  return !s.shared->runs_on_host() || s.dry || joint_friction.defined() ||
         *kept_contacts(s).count > 0;
}

ArticulationArguments step_arguments_of(const Step& s) {
  return step_arguments_of<float>(s,
                                  [](const Tensor& values, int32_t) { return argument(values); });
}

namespace {

ArticulationStepArguments forward_arguments(const Step& s, const ArticulationArguments& in,
                                            const StepOutputs& to) {
  return {.in = in,
          .q_next = argument(to[0]),
          .qd_next = argument(to[1]),
          .body_q = argument(to[2]),
          .body_qd = argument(to[3]),
          .qdd = argument(to[4]),
          .branch = argument(to[5]),
          .status = s.status,
          .workspace = s.workspace,
          .stride = s.stride};
}

}  // namespace

void run_host(const Step& s, const ArticulationArguments& in, const StepOutputs* from,
              const StepOutputs& to) {
  ArticulationStepArguments a = forward_arguments(s, in, to);
  if (from != nullptr) {
    a.in.arrays.q = argument((*from)[0]);
    a.in.arrays.qd = argument((*from)[1]);
  }
  s.shared->trees->step(in_memory(a), *s.model, s.shared->all, s.options, nullptr, true);
}
StepOutputs outputs_of(const Step& s) {
  StepOutputs first;
  for (size_t i = 0; i < first.size(); ++i) first[i] = s.outputs[i].tensor;
  return first;
}

namespace {

// Stores the events and branches of a step's contacts. Call this after a recorded step.
void report_contacts(const Step& s) {
  ArticulationStep::Shared& shared = *s.shared;
  if (s.motion) {
    const std::shared_ptr<const Step> last = s.continues ? shared.last.lock() : nullptr;
    std::span<const LandedRow> landed;
    if (last) landed = last->motion->found.landed;
    s.motion->found = shared.contacts.events(numbers(s.in(kAt.qd)), s.continues, landed);
  }
  shared.contacts.note_branches();
  if (!shared.trees) return;
  add_branches(shared.contacts.branches(), shared.branches);
  shared.contacts.clear_branches();
}

// Runs a step with contacts. `reports`: also stores the branches, and writes the contact forces.
void run_contacts(const Step& s, const ArticulationStepArguments& step, bool reports) {
  ArticulationStep::Shared& shared = *s.shared;
  ContactArguments rows = kept_arguments(s);
  ContactRecord record = contact_record(s);
  if (reports && s.force) rows.force = *s.force;
  if (reports && s.point_id) rows.point_id = *s.point_id;
  record.notes = reports;
  shared.contacts.step(step, rows, s.options, record, shared.trees ? &*shared.trees : nullptr);
  if (shared.trees) *kept_contacts(s).far = shared.contacts.far_island(s.options.pgs_tolerance);
  if (reports) report_contacts(s);
}

void run_forward(const Step& s, bool reports) {
  const nova::NoGrad no_grad;
  ArticulationStep::Shared& shared = *s.shared;
  const Unrecorded unrecorded(shared.runs_on_host());
  const ArticulationStepArguments step = forward_arguments(s, step_arguments_of(s), outputs_of(s));
  if (s.contacts.defined()) {
    ContactSteps& contacts = shared.contacts;
    if (s.copies_contacts())
      contacts.copy(s.found ? s.found->arguments() : contacts.none(), kept_arguments(s));
    if (acts(s, Tensor()) || contacts.has_seen()) return run_contacts(s, step, reports);
    *kept_contacts(s).far = {};
    if (reports) articulation::note_step(articulation::BranchNotes(), shared.branches);
  }
  if (!shared.runs_on_host()) return run(tree_step_kernel(), s.count, step);
  shared.trees->step(in_memory(step), *s.model, shared.all, s.options, nullptr, true);
}

}  // namespace

std::vector<Tensor> reads_of(const Step& s) {
  std::vector<Tensor> all;
  for (const Named& in : s.inputs) all.push_back(in.tensor);
  for (size_t i = kFrameP; i <= kTargetMode; ++i) all.push_back(s.values[i].tensor);
  if (s.inputs[kMu].tensor.defined()) all.push_back(tensor_of(s.model->shape_mixing));
  return all;
}

void submit_forward(const std::shared_ptr<const Step>& step, bool reports) {
  const auto run = [step, reports] { run_forward(*step, reports); };
  if (!works_on_host(*step)) return run();
  const auto replay = [run, step] {
    run();
    const std::span<const int32_t> status = {step->status.data(), step->status.rows()};
    const KeptContacts kept = kept_contacts(*step);
    check_contact_status(status, kName, step->model.get(), kept.shape0, kept.shape1);
    check_status(*step->model, step->shared->articulations, status, kName);
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
    run_host(s, *s.host, &from, to);
    from = to;
  }
}

}  // namespace novaphy::diff::detail
