#include "diff_vbd_bodies.h"

#include <utility>

#include "diff_vbd_step.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/named_step.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/vbd/diff_vbd.h"

namespace novaphy::diff {

using nova::Tensor;

std::vector<RecordedBodies::Input> RecordedBodies::differentiable() const {
  using D = VbdBodyDerivatives;
  const Model& m = *model;
  const Control* const c = control.get();
  const std::pair<const Array&, Array D::*> arrays[] = {
      {in->body_q, &D::body_q},
      {in->body_qd, &D::body_qd},
      {in->body_f, &D::body_f},
      {m.gravity, &D::gravity},
      {m.body_mass, &D::body_mass},
      {m.body_inertia, &D::body_inertia},
      {c != nullptr ? c->joint_f : m.joint_f, &D::joint_f},
      {c != nullptr ? c->joint_target_q : m.joint_target_q, &D::joint_target_q},
      {c != nullptr ? c->joint_target_qd : m.joint_target_qd, &D::joint_target_qd},
      {m.joint_target_ke, &D::joint_target_ke},
      {m.joint_target_kd, &D::joint_target_kd},
      {m.joint_damping, &D::joint_damping},
      {m.joint_armature, &D::joint_armature},
      {m.joint_friction, &D::joint_friction},
      {m.shape_material_ke, &D::shape_material_ke},
      {m.shape_material_kd, &D::shape_material_kd},
      {m.shape_material_mu, &D::shape_material_mu}};
  std::vector<Input> all;
  for (const auto& [array, derivative] : arrays)
    if (array.rows() != 0) all.push_back({tensor_of(nova::operand_of(array)), derivative});
  return all;
}

namespace {

Array array_of(const Tensor& tensor) {
  return tensor.defined()
             ? Array(novaphy::DType::float32, static_cast<size_t>(tensor.size()), 1, tensor.range())
             : Array();
}

}  // namespace

void RecordedBodies::tangent(std::span<const Tensor> tangents,
                             std::span<const Tensor> outputs) const {
  const nova::NoGrad no_grad;
  const std::vector<Input> all = differentiable();
  VbdBodyDerivatives direction;
  for (size_t k = 0; k < all.size(); ++k) direction.*all[k].derivative = array_of(tangents[k]);
  Array found[2];
  for (size_t k = 0; k < 2; ++k) {
    const UntrackedScope untracked;
    found[k] =
        Array(novaphy::DType::float32, static_cast<size_t>(outputs[k].size()), model->device());
  }
  steps->tangent(*solution, *in, control.get(), dt, direction, found[0], found[1]);
  report.note(steps->info());
  for (size_t k = 0; k < 2; ++k)
    nova::InputGradient{outputs[k], false}.put(
        Tensor(found[k].range(), outputs[k].shape(), nova::DType::F32));
}

void RecordedBodies::backward(std::span<const Tensor> outputs,
                              std::span<const nova::InputGradient> to) const {
  const nova::NoGrad no_grad;
  const std::vector<Input> all = differentiable();
  VbdBodyDerivatives adjoints, gradients;
  adjoints.body_q = array_of(outputs[0]);
  adjoints.body_qd = array_of(outputs[1]);
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    const UntrackedScope untracked;
    gradients.*all[k].derivative =
        Array(novaphy::DType::float32, static_cast<size_t>(all[k].tensor.size()), model->device());
  }
  steps->backward(*solution, *in, control.get(), dt, adjoints, gradients);
  report.note(steps->info());
  for (size_t k = 0; k < all.size(); ++k)
    if (to[k].wanted())
      to[k].put(
          Tensor((gradients.*all[k].derivative).range(), to[k].grad.shape(), nova::DType::F32));
}

namespace {

// Makes the step with views of its inputs.
std::shared_ptr<RecordedBodies> step_of(const std::shared_ptr<const Model>& model,
                                        const SimState& in, const StepInputs& inputs) {
  const UntrackedScope untracked;
  auto step = std::make_shared<RecordedBodies>();
  step->model = model;
  step->dt = inputs.dt;
  step->of_rollout = inputs.step;
  StateFields fields = in;
  fields.body_f = DeviceArray<SpatialVectorf>(Array(novaphy::DType::spatial_vector,
                                                    static_cast<size_t>(inputs.body_forces.rows), 1,
                                                    inputs.body_forces.range));
  step->in = std::make_shared<const SimState>(*model, std::move(fields));
  if (inputs.control != nullptr) {
    const auto control = std::make_shared<Control>(*model);
    static_cast<ControlFields&>(*control) = *inputs.control;
    step->control = control;
  }
  return step;
}

// Returns whether the contacts of a step were found from its state. A rollout with given contacts
// holds all of them.
bool contacts_follow(const Model& m, const SimState& in, const StepInputs& inputs) {
  if (inputs.step >= 0) return inputs.tables != nullptr;
  return inputs.contacts != nullptr && inputs.contacts->rigid_contacts_found_from(m, in.body_q);
}

NotedStep noted_step(const SimState& in, const SimState& out, const Contacts* contacts,
                     bool freezes) {
  const UntrackedScope untracked;
  NotedStep noted;
  noted.start = in.body_q.range()->data();
  noted.end = out.body_q.range()->data();
  noted.body_q = freezes ? out.body_q : in.body_q;
  noted.body_qd = freezes ? out.body_qd : in.body_qd;
  if (contacts == nullptr) return noted;
  noted.contacts = std::make_shared<const Contacts>(contacts->clone());
  noted.rigid = true;
  noted.rigid_contact_moves = !freezes;
  return noted;
}

}  // namespace

void DiffSolverVBD::record_bodies(const SimState& in, const SimState& out,
                                  const StepInputs& inputs) {
  const Model& m = *model();
  require(nova::current_capture() == nullptr, ErrorKind::NotImplemented, RecordedStep::kName,
          ": expected no capture for a model with bodies");
  require(inputs.checkpoints == nullptr, ErrorKind::NotImplemented, "DiffSolverVBD.rollout",
          ": trajectory: expected all states kept (checkpoint=1) for a model with bodies");
  nova::Tape* const tape = nova::Tape::active();
  const std::shared_ptr<RecordedBodies> step = step_of(model(), in, inputs);
  step->steps = bodies_;
  std::vector<Tensor> tensors;
  for (const RecordedBodies::Input& input : step->differentiable()) tensors.push_back(input.tensor);
  if (tape != nullptr) check_other_arrays(*tape, m, inputs.contacts, tensors);
  {
    const nova::NoGrad no_grad;
    DeviceArray<Transformf> q_out = out.body_q;  // forward() runs without a recorder
    DeviceArray<SpatialVectorf> qd_out = out.body_qd;
    q_out.mutable_data();
    qd_out.mutable_data();
    step->solution = bodies_->forward(*step->in, out, step->control.get(), inputs.contacts,
                                      inputs.dt, contacts_follow(m, in, inputs));
  }
  if (tape == nullptr) return;
  number_of_step(in.body_q.range()->data(), out.body_q.range()->data());
  step->report = note_step(
      noted_step(in, out, inputs.contacts, bodies_->has_frozen_contacts(*step->solution)), true);
  nova::CustomOp op;
  op.name = "vbd_bodies_step";
  op.inputs = tensors;
  op.outputs = {tensor_of(nova::operand_of(out.body_q)), tensor_of(nova::operand_of(out.body_qd))};
  op.reads = tensors;
  op.reads.push_back(Tensor::view(m.body_inv_mass));
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) {
    const auto run = [&] { step->backward(outputs, to); };
    step->of_rollout < 0 ? run() : named_step(step->of_rollout, run);
  };
  op.jvp = [step](std::span<const Tensor> tangents, std::span<const Tensor> outputs) {
    const auto run = [&] { step->tangent(tangents, outputs); };
    step->of_rollout < 0 ? run() : named_step(step->of_rollout, run);
  };
  tape->record_custom(std::move(op));
}

}  // namespace novaphy::diff
