#include "novaphy/vbd/diff_vbd.h"

#include <cstring>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

using nova::Tensor;

constexpr const char* kName = "DiffSolverVBD.step";

Tensor tensor_of(const nova::Operand& operand) {
  return {operand.range, {operand.rows, operand.width}, nova::DType::F32};
}
const Vec3f* rows_of(const Tensor& tensor) {
  return reinterpret_cast<const Vec3f*>(tensor.data<float>());
}

// Arrays of the model that a step reads and that have no gradient yet.
std::vector<std::pair<const char*, const Array*>> arrays_without_gradient(const Model& m) {
  return {{"particle_mass", &m.particle_mass},
          {"particle_inv_mass", &m.particle_inv_mass},
          {"particle_radius", &m.particle_radius},
          {"particle_tri_pose", &m.particle_tri_pose},
          {"particle_tri_area", &m.particle_tri_area},
          {"particle_edge_rest_length", &m.particle_edge_rest_length},
          {"particle_tet_pose", &m.particle_tet_pose},
          {"shape_margin", &m.shape_margin},
          {"shape_material_ke", &m.shape_material_ke},
          {"shape_material_kd", &m.shape_material_kd},
          {"shape_material_mu", &m.shape_material_mu},
          {"gravity", &m.gravity}};
}

}  // namespace

// What a recorded step and its backward work with.
struct DiffSolverVBD::Step {
  explicit Step(std::shared_ptr<const Model> of) : model(std::move(of)) {}

  std::shared_ptr<const Model> model;
  std::shared_ptr<UnrolledVbd> unrolled;
  std::shared_ptr<const Contacts> contacts;
  Tensor q, qd, f;
  DeviceArray<float> tri_activation, tet_activation;
  DeviceArray<Vec3f> q_out, qd_out;
  float dt = 0.0f;
  // The model's numbers when the step was recorded.
  float soft_contact_ke = model->soft_contact_ke, soft_contact_kd = model->soft_contact_kd,
        soft_contact_mu = model->soft_contact_mu;

  // ErrorKind::Runtime when a number was set to another value: the step would run with it.
  void check_numbers() const {
    const auto check = [](const char* name, float then, float now) {
      require(then == now, ErrorKind::Runtime, kName, ": model.", name,
              " was set to another value after recording: it was ", then, ", it is ", now);
    };
    check("soft_contact_ke", soft_contact_ke, model->soft_contact_ke);
    check("soft_contact_kd", soft_contact_kd, model->soft_contact_kd);
    check("soft_contact_mu", soft_contact_mu, model->soft_contact_mu);
  }

  VbdStepInputs inputs() const {
    check_numbers();
    return {rows_of(q),      rows_of(qd),    rows_of(f), &tri_activation,
            &tet_activation, contacts.get(), dt};
  }
  void forward() { unrolled->forward(inputs(), q_out.mutable_data(), qd_out.mutable_data()); }

  // The inputs that have a gradient, and where VbdStepGradients takes it.
  struct Input {
    Tensor tensor;
    float* VbdStepGradients::*numbers = nullptr;
    Vec3f* VbdStepGradients::*vectors = nullptr;
  };
  std::vector<Input> differentiable() const {
    using G = VbdStepGradients;
    std::vector<Input> inputs = {
        {q, nullptr, &G::particle_q}, {qd, nullptr, &G::particle_qd}, {f, nullptr, &G::particle_f}};
    const auto add = [&](const DeviceArray<float>& array, float* G::*member) {
      if (array.rows() != 0) inputs.push_back({tensor_of(nova::operand_of(array)), member});
    };
    const Model& m = *model;
    add(m.particle_spring_stiffness, &G::particle_spring_stiffness);
    add(m.particle_spring_damping, &G::particle_spring_damping);
    add(m.particle_spring_rest_length, &G::particle_spring_rest_length);
    add(m.particle_tri_material, &G::particle_tri_material);
    add(tri_activation, &G::particle_tri_activation);
    add(m.particle_edge_material, &G::particle_edge_material);
    add(m.particle_edge_rest_angle, &G::particle_edge_rest_angle);
    add(m.particle_tet_material, &G::particle_tet_material);
    add(tet_activation, &G::particle_tet_activation);
    return inputs;
  }

  void backward(std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) const {
    const std::vector<Input> all = differentiable();
    VbdStepGradients gradients;
    std::vector<std::vector<float>> values(all.size());
    for (size_t k = 0; k < all.size(); ++k) {
      if (!to[k].wanted()) continue;
      values[k].resize(static_cast<size_t>(all[k].tensor.size()));
      if (all[k].numbers != nullptr) {
        gradients.*all[k].numbers = values[k].data();
      } else {
        gradients.*all[k].vectors = reinterpret_cast<Vec3f*>(values[k].data());
      }
    }
    unrolled->backward(inputs(), outputs[0].defined() ? rows_of(outputs[0]) : nullptr,
                       outputs[1].defined() ? rows_of(outputs[1]) : nullptr, gradients);
    for (size_t k = 0; k < all.size(); ++k)
      if (to[k].wanted())
        to[k].put(Tensor::from_host(values[k], all[k].tensor.shape(), Device::cpu()));
  }
};

DiffSolverVBD::DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options)
    : DiffSolverBase(std::move(model)),
      options_(options),
      unrolled_(std::make_shared<UnrolledVbd>(
          this->model(), VbdOptions{.iterations = options.iterations,
                                    .friction_epsilon = options.friction_epsilon,
                                    .initial_guess = options.initial_guess,
                                    .lhs_regularization = options.lhs_regularization})) {}

VbdGradientInfo DiffSolverVBD::gradient_info() const { return {"exact", unrolled_->residual()}; }

// A copy of contacts that may be found anew before backward reads them; that of the step before
// where they are the same.
std::shared_ptr<const Contacts> DiffSolverVBD::kept(const Contacts* contacts) {
  if (contacts == nullptr) return nullptr;
  const auto same = [](const Array& a, const Array& b) {
    return a.bytes() == b.bytes() &&
           (a.bytes() == 0 || std::memcmp(a.raw(), b.raw(), a.bytes()) == 0);
  };
  const Contacts* last = last_contacts_.get();
  if (last == nullptr || !same(last->soft_contact_count, contacts->soft_contact_count) ||
      !same(last->soft_contact_particle, contacts->soft_contact_particle) ||
      !same(last->soft_contact_shape, contacts->soft_contact_shape) ||
      !same(last->soft_contact_body_pos, contacts->soft_contact_body_pos) ||
      !same(last->soft_contact_body_vel, contacts->soft_contact_body_vel) ||
      !same(last->soft_contact_normal, contacts->soft_contact_normal))
    last_contacts_ = std::make_shared<const Contacts>(contacts->clone());
  return last_contacts_;
}

void DiffSolverVBD::step(SimState& state_in, SimState& state_out, const Control* control,
                         const Contacts* contacts, float dt) {
  require(!nova::current_capture(), ErrorKind::Runtime, kName,
          " inside a ScopedCapture: it runs on the host and cannot be captured");
  const ExclusiveUse::Scope scope = use(kName);
  check_step(kName, state_in, state_out, control, contacts, dt);
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  StepInputs inputs;
  inputs.control = control;
  inputs.contacts = contacts;
  inputs.forces = nova::operand_of(state_in.particle_f);
  inputs.dt = dt;
  record_step(state_in, state_out, inputs, {});
}

bool DiffSolverVBD::begin_rollout(const RolloutInputs&) {
  require(
      !nova::current_capture(), ErrorKind::Runtime,
      "DiffSolverVBD.rollout inside a ScopedCapture: it runs on the host and cannot be captured");
  return model()->particle_count() > 0;
}

void DiffSolverVBD::record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                                StepScratch) {
  const Model& m = *model();
  nova::flush_deferred();
  nova::Tape* const tape = nova::Tape::active();
  auto step = std::make_shared<Step>(model());
  step->unrolled = unrolled_;
  step->contacts = kept(inputs.contacts);
  step->q = tensor_of(nova::operand_of(in.particle_q));
  step->qd = tensor_of(nova::operand_of(in.particle_qd));
  step->f = tensor_of(inputs.forces);
  const Control* const control = inputs.control;
  step->tri_activation =
      control != nullptr ? control->particle_tri_activation : m.particle_tri_activation;
  step->tet_activation =
      control != nullptr ? control->particle_tet_activation : m.particle_tet_activation;
  step->q_out = out.particle_q;
  step->qd_out = out.particle_qd;
  step->dt = inputs.dt;
  if (tape != nullptr)
    for (const auto& [name, array] : arrays_without_gradient(m))
      require(array->rows() == 0 || !tape->carries_gradient(*array->range()),
              ErrorKind::NotImplemented, kName, ": model.", name,
              ": its gradient is not there yet; set requires_grad = false there");
  step->forward();
  if (tape == nullptr) return;
  nova::CustomOp op;
  op.name = "vbd_step";
  for (const Step::Input& input : step->differentiable()) op.inputs.push_back(input.tensor);
  op.outputs = {tensor_of(nova::operand_of(out.particle_q)),
                tensor_of(nova::operand_of(out.particle_qd))};
  op.reads = op.inputs;
  for (const auto& [name, array] : arrays_without_gradient(m))
    if (array->rows() != 0) op.reads.push_back(Tensor::view(*array));
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) {
    step->backward(outputs, to);
  };
  op.forward = [step] { step->forward(); };
  op.submits_only = false;
  tape->record_custom(std::move(op));
}

}  // namespace novaphy::diff
