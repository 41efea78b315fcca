#include "novaphy/vbd/diff_vbd.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/nova/host_work.h"
#include "novaphy/nova/kernel.h"
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

// Rows of three numbers; without rows where the tensor is not defined.
DeviceArray<Vec3f> array_of(const Tensor& tensor) {
  if (!tensor.defined() || tensor.size() == 0) return {};
  return DeviceArray<Vec3f>(
      Array(novaphy::DType::vec3, static_cast<size_t>(tensor.size() / 3), 1, tensor.range()));
}

// Rows of a tensor, as memory of its own.
Tensor part_of(const Tensor& all, size_t first_row, size_t rows) {
  const auto row = static_cast<size_t>(all.shape().back()) * sizeof(float);
  const auto& range = all.range();
  return {range->storage().range(range->offset() + first_row * row, rows * row),
          {static_cast<int64_t>(rows), all.shape().back()},
          nova::DType::F32};
}

// What the adaptive guess of the next step looks at.
const nova::Kernel& keep_velocity_kernel() {
  static const nova::Kernel kernel = nova::make_kernel(
      "vbd_keep_velocity", {{"particle_qd", nova::DType::F32, 3, nova::Access::Direct}},
      {{"last_velocity", 4}}, [](nova::TraceContext& c) {
        return std::vector{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2), nova::Real(1.0f)};
      });
  return kernel;
}
void keep_velocity_as(const nova::Operand& qd, const Tensor& rows) {
  const nova::Operand to = rows.operand();
  keep_velocity_kernel().launch(qd.rows, {&qd, 1}, {&to, 1});
}

}  // namespace

// Arrays of the model that a step has a gradient by, besides the activations.
#define NOVAPHY_VBD_MODEL_INPUTS(X) \
  X(gravity)                        \
  X(particle_mass)                  \
  X(particle_radius)                \
  X(particle_spring_stiffness)      \
  X(particle_spring_damping)        \
  X(particle_spring_rest_length)    \
  X(particle_tri_pose)              \
  X(particle_tri_area)              \
  X(particle_tri_material)          \
  X(particle_edge_material)         \
  X(particle_edge_rest_angle)       \
  X(particle_edge_rest_length)      \
  X(particle_tet_pose)              \
  X(particle_tet_material)          \
  X(shape_margin)                   \
  X(shape_material_ke)              \
  X(shape_material_kd)              \
  X(shape_material_mu)

// What a recorded step and its backward work with.
struct DiffSolverVBD::Step {
  explicit Step(std::shared_ptr<const Model> of) : model(std::move(of)) {}

  std::shared_ptr<const Model> model;
  std::shared_ptr<DifferentiableVbd> steps;
  std::shared_ptr<const Contacts> contacts;
  std::shared_ptr<std::string> failure;  // of replays; see DiffSolverVBD::gradient_info
  std::shared_ptr<ExclusiveUse> in_use;
  Tensor q, qd, f, targets;  // the targets of all steps; undefined: none
  Tensor last;               // of the adaptive guess, else undefined
  size_t first_target = 0, target_count = 0;
  DeviceArray<float> tri_activation, tet_activation;
  DeviceArray<Vec3f> q_out, qd_out;
  float dt = 0.0f;
  bool implicit = false;
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
    const Vec3f* const to = targets.defined() ? rows_of(targets) + first_target : nullptr;
    const auto* const before =
        last.defined() ? reinterpret_cast<const Vec4f*>(last.data<float>()) : nullptr;
    return {rows_of(q),     rows_of(qd), rows_of(f), &tri_activation, &tet_activation,
            contacts.get(), dt,          to,         before};
  }
  VbdLaunchInputs launch_inputs() const {
    check_numbers();
    return {array_of(q),
            array_of(qd),
            array_of(f),
            tri_activation,
            tet_activation,
            contacts.get(),
            targets.defined() ? array_of(part_of(targets, first_target, target_count))
                              : DeviceArray<Vec3f>(),
            dt,
            last.defined()
                ? DeviceArray<Vec4f>(Array(novaphy::DType::vec4,
                                           static_cast<size_t>(last.size() / 4), 1, last.range()))
                : DeviceArray<Vec4f>()};
  }
  bool on_device() const { return !model->device().is_cpu(); }
  // ErrorKind::NotImplemented: a capture on a device of what the host decides about.
  void check_capture() const {
    require(!implicit || !on_device() || nova::current_capture() == nullptr,
            ErrorKind::NotImplemented, kName,
            ": gradient: expected \"unrolled\" inside a ScopedCapture on ", model->device().str(),
            ", got \"implicit\", for which the host decides how far to go");
  }
  void forward() {
    check_capture();
    if (!on_device()) return steps->forward(inputs(), q_out.mutable_data(), qd_out.mutable_data());
    const nova::NoGrad no_grad;
    steps->forward(launch_inputs(), q_out, qd_out, in_use);
  }
  // Now, or in the replays of a capture.
  static void submit_forward(const std::shared_ptr<Step>& step) {
    if (nova::current_capture() != nullptr && !step->on_device()) {
      capture_forward(step);
    } else {
      step->forward();
    }
  }

  // What forward reads, besides what has a gradient.
  std::vector<Tensor> reads() const {
    std::vector<Tensor> all;
    for (const Input& input : differentiable()) all.push_back(input.tensor);
    all.push_back(Tensor::view(model->particle_inv_mass));
    if (contacts != nullptr)
      ContactFields::visit(static_cast<const ContactFields&>(*contacts), [&](const FieldInfo& info,
                                                                             const Array& array) {
        if (std::string_view(info.name).starts_with("soft_") && array.rows() != 0)
          all.push_back(Tensor::view(array));
      });
    return all;
  }
  static void capture_forward(const std::shared_ptr<Step>& step) {
    const std::vector<Tensor> results = {tensor_of(nova::operand_of(step->q_out)),
                                         tensor_of(nova::operand_of(step->qd_out))};
    nova::capture_host_work({.name = kName,
                             .reads = step->reads(),
                             .results = results,
                             .failure = step->failure.get(),
                             .run = [step, results] {
                               step->steps->forward(
                                   step->inputs(), static_cast<Vec3f*>(results[0].range()->data()),
                                   static_cast<Vec3f*>(results[1].range()->data()));
                             }});
  }
  static void capture_backward(const std::shared_ptr<Step>& step, std::vector<Tensor> outputs,
                               std::vector<nova::InputGradient> to) {
    std::vector<Tensor> reads = step->reads(), results;
    for (const Tensor& output : outputs) reads.push_back(output);
    for (const nova::InputGradient& gradient : to)
      if (gradient.wanted()) results.push_back(gradient.grad);
    nova::capture_host_work({.name = kName,
                             .reads = reads,
                             .results = results,
                             .failure = step->failure.get(),
                             .run = [step, outputs, to] { step->add_backward(outputs, to); }});
  }

  // An input that has a gradient, and where it is among the derivatives of a step.
  struct Input {
    Tensor tensor;
    float* VbdStepGradients::*bars = nullptr;
    const float* VbdStepTangents::*slopes = nullptr;
    Vec3f* VbdStepGradients::*vector_bars = nullptr;
    const Vec3f* VbdStepTangents::*vector_slopes = nullptr;
    Array VbdStepArrays::*array_bars = nullptr;
    bool is_targets = false;

    // Of those that a step reads.
    size_t size(const Step& step) const {
      return static_cast<size_t>(is_targets ? 3 * step.target_count : tensor.size());
    }
  };
  std::vector<Input> differentiable() const {
    std::vector<Input> all;
    const auto add = [&](const Tensor& tensor, auto bars, auto slopes,
                         Array VbdStepArrays::*array_bars) {
      if constexpr (std::is_same_v<decltype(bars), float * VbdStepGradients::*>) {
        all.push_back({tensor, bars, slopes, nullptr, nullptr, array_bars});
      } else {
        all.push_back({tensor, nullptr, nullptr, bars, slopes, array_bars});
      }
    };
    const Model& m = *model;
#define NOVAPHY_ADD(input, name) \
  add(input, &VbdStepGradients::name, &VbdStepTangents::name, &VbdStepArrays::name)
#define NOVAPHY_ADD_ARRAY(array, name) \
  if ((array).rows() != 0) NOVAPHY_ADD(tensor_of(nova::operand_of(array)), name)
    NOVAPHY_ADD(q, particle_q);
    NOVAPHY_ADD(qd, particle_qd);
    NOVAPHY_ADD(f, particle_f);
    if (targets.defined()) {
      NOVAPHY_ADD(targets, targets);
      all.back().is_targets = true;
    }
    if (last.defined()) NOVAPHY_ADD(last, last_velocity);
    NOVAPHY_ADD_ARRAY(tri_activation, particle_tri_activation);
    NOVAPHY_ADD_ARRAY(tet_activation, particle_tet_activation);
#define NOVAPHY_ADD_MODEL(name) NOVAPHY_ADD_ARRAY(m.name, name);
    NOVAPHY_VBD_MODEL_INPUTS(NOVAPHY_ADD_MODEL)
#undef NOVAPHY_ADD_MODEL
#undef NOVAPHY_ADD_ARRAY
#undef NOVAPHY_ADD
    return all;
  }

  // The derivatives that are wanted, in the order of the inputs.
  std::vector<std::vector<float>> derivatives(std::span<const Tensor> outputs,
                                              std::span<const nova::InputGradient> to) const {
    const std::vector<Input> all = differentiable();
    VbdStepGradients gradients;
    std::vector<std::vector<float>> values(all.size());
    for (size_t k = 0; k < all.size(); ++k) {
      if (!to[k].wanted()) continue;
      values[k].resize(all[k].size(*this));
      if (all[k].bars != nullptr) {
        gradients.*all[k].bars = values[k].data();
      } else {
        gradients.*all[k].vector_bars = reinterpret_cast<Vec3f*>(values[k].data());
      }
    }
    steps->backward(inputs(), outputs[0].defined() ? rows_of(outputs[0]) : nullptr,
                    outputs[1].defined() ? rows_of(outputs[1]) : nullptr, gradients);
    return values;
  }

  // The same on a device.
  std::vector<Array> device_derivatives(std::span<const Tensor> outputs,
                                        std::span<const nova::InputGradient> to) const {
    const std::vector<Input> all = differentiable();
    VbdStepArrays gradients;
    std::vector<Array> values(all.size());
    for (size_t k = 0; k < all.size(); ++k) {
      if (!to[k].wanted()) continue;
      const Unobserved unobserved;
      values[k] = Array(novaphy::DType::float32, all[k].size(*this), model->device());
      gradients.*all[k].array_bars = values[k];
    }
    steps->backward(launch_inputs(), array_of(outputs[0]), array_of(outputs[1]), gradients, in_use);
    return values;
  }

  void backward(std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) const {
    check_capture();
    if (on_device()) {
      const nova::NoGrad no_grad;
      const std::vector<Array> values = device_derivatives(outputs, to);
      return put(to, [&](size_t k, const nova::Shape& shape) {
        return Tensor(values[k].range(), shape, nova::DType::F32);
      });
    }
    const std::vector<std::vector<float>> values = derivatives(outputs, to);
    put(to, [&](size_t k, const nova::Shape& shape) {
      return Tensor::from_host(values[k], shape, Device::cpu());
    });
  }
  // `value`: the derivative by an input, as a tensor of a shape.
  template <class Value>
  void put(std::span<const nova::InputGradient> to, const Value& value) const {
    const std::vector<Input> all = differentiable();
    for (size_t k = 0; k < all.size(); ++k) {
      if (!to[k].wanted()) continue;
      nova::InputGradient where = to[k];
      if (all[k].is_targets) {  // those of the other steps stay
        if (!where.add) where.put({});
        where = {part_of(where.grad, first_target, target_count), true};
      }
      where.put(value(k, where.grad.shape()));
    }
  }
  // The same, as part of a replay: what lies there is written by nobody else meanwhile.
  void add_backward(std::span<const Tensor> outputs,
                    std::span<const nova::InputGradient> to) const {
    const std::vector<std::vector<float>> values = derivatives(outputs, to);
    const std::vector<Input> all = differentiable();
    for (size_t k = 0; k < all.size(); ++k) {
      if (!to[k].wanted()) continue;
      auto* grad = static_cast<float*>(to[k].grad.range()->data());
      if (!to[k].add) std::fill_n(grad, to[k].grad.size(), 0.0f);
      if (all[k].is_targets) grad += 3 * first_target;
      for (size_t i = 0; i < values[k].size(); ++i)
        grad[i] = to[k].add || all[k].is_targets ? grad[i] + values[k][i] : values[k][i];
    }
  }

  // The slopes of positions and velocities, along those of the inputs.
  std::array<std::vector<Vec3f>, 2> tangents(std::span<const Tensor> slopes) const {
    const std::vector<Input> all = differentiable();
    VbdStepTangents direction;
    for (size_t k = 0; k < all.size(); ++k) {
      if (!slopes[k].defined()) continue;
      const auto* const first =
          slopes[k].data<float>() + (all[k].is_targets ? 3 * first_target : 0);
      if (all[k].slopes != nullptr) {
        direction.*all[k].slopes = first;
      } else {
        direction.*all[k].vector_slopes = reinterpret_cast<const Vec3f*>(first);
      }
    }
    const auto n = static_cast<size_t>(model->particle_count());
    std::array<std::vector<Vec3f>, 2> found = {std::vector<Vec3f>(n), std::vector<Vec3f>(n)};
    steps->tangent(inputs(), direction, found[0].data(), found[1].data());
    return found;
  }
  void tangent(std::span<const Tensor> slopes, std::span<const Tensor> outputs) const {
    const std::array<std::vector<Vec3f>, 2> found = tangents(slopes);
    for (size_t k = 0; k < 2; ++k)
      nova::InputGradient{outputs[k], false}.put(Tensor::from_host(
          std::span(&found[k].front().x, 3 * found[k].size()), outputs[k].shape(), Device::cpu()));
  }
  static void capture_tangent(const std::shared_ptr<Step>& step, std::vector<Tensor> slopes,
                              const std::vector<Tensor>& outputs) {
    std::vector<Tensor> reads = step->reads();
    for (const Tensor& slope : slopes)
      if (slope.defined()) reads.push_back(slope);
    nova::capture_host_work({.name = kName,
                             .reads = reads,
                             .results = outputs,
                             .failure = step->failure.get(),
                             .run = [step, slopes, outputs] {
                               const auto found = step->tangents(slopes);
                               for (size_t k = 0; k < 2; ++k)
                                 std::copy(found[k].begin(), found[k].end(),
                                           static_cast<Vec3f*>(outputs[k].range()->data()));
                             }});
  }

  // ErrorKind::NotImplemented, by name: an array that carries a gradient but has none in a step.
  void check_others(const nova::Tape& tape, const Contacts* given) const {
    const std::vector<Input> all = differentiable();
    const auto check = [&](const char* of, const FieldInfo& info, const Array& array) {
      if (array.rows() == 0 || !tape.carries_gradient(*array.range())) return;
      for (const Input& input : all)
        if (input.tensor.range()->overlaps(*array.range())) return;
      fail(ErrorKind::NotImplemented, kName, ": ", of, ".", info.name,
           ": a step of VBD has no gradient by it; set requires_grad = false there");
    };
    ModelFields::visit(static_cast<const ModelFields&>(*model),
                       [&](const FieldInfo& info, const Array& array) {
                         const std::string_view name = info.name;
                         if (name != "particle_q" && name != "particle_qd")
                           check("model", info, array);
                       });
    if (given != nullptr)
      ContactFields::visit(
          static_cast<const ContactFields&>(*given),
          [&](const FieldInfo& info, const Array& array) { check("contacts", info, array); });
  }
};

DiffSolverVBD::DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options)
    : DiffSolverBase(std::move(model)),
      options_(options),
      steps_(std::make_shared<DifferentiableVbd>(
          this->model(),
          VbdOptions{.iterations = options.iterations,
                     .friction_epsilon = options.friction_epsilon,
                     .initial_guess = options.initial_guess,
                     .lhs_regularization = options.lhs_regularization},
          options.gradient)) {
  if (looks_back())
    last_velocity_ =
        DeviceArray<Vec4f>(static_cast<size_t>(this->model()->particle_count()), device());
}

void DiffSolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("DiffSolverVBD.reset");
  recorded_velocity_ = {};
  if (last_velocity_.rows() == 0) return;
  const nova::NoGrad no_grad;
  if (nova::OpList* capture = nova::current_capture()) capture->uses(in_use());
  nova::submit_fill(last_velocity_.range(), 0.0f);
}

std::vector<ScratchSpec> DiffSolverVBD::step_scratch() const {
  if (!looks_back()) return {};
  return {{novaphy::DType::vec4, static_cast<size_t>(model()->particle_count()), 1}};
}

DeviceArray<Vec4f> DiffSolverVBD::new_velocities() const {
  const Unobserved unobserved;
  return DeviceArray<Vec4f>(static_cast<size_t>(model()->particle_count()), device());
}

// What the step reads: on a tape memory that stays as it is until backward has read it.
Tensor DiffSolverVBD::last_velocity(StepInputs::Checkpoints* checkpoints) {
  if (!looks_back()) return {};
  const auto rows = static_cast<int64_t>(model()->particle_count());
  const auto tensor = [&](const Array& array) {
    return Tensor(array.range(), {rows, 4}, nova::DType::F32);
  };
  if (checkpoints != nullptr && checkpoints->is_recomputed)
    return tensor(checkpoints->kept.contains(checkpoints->step)
                      ? checkpoints->kept.at(checkpoints->step)
                      : checkpoints->kept.at(-1));
  const nova::Tape* const tape = nova::Tape::active();
  const bool is_recorded = tape != nullptr && recorded_velocity_.rows.defined() &&
                           recorded_velocity_.capture == nova::current_capture() &&
                           tape->carries_gradient(*recorded_velocity_.rows.range());
  const bool keep = checkpoints != nullptr && checkpoints->kept.empty();  // the first step
  Tensor last = is_recorded ? recorded_velocity_.rows : tensor(last_velocity_);
  if (!is_recorded && (tape != nullptr || keep)) {
    const nova::NoGrad no_grad;
    const DeviceArray<Vec4f> copy = new_velocities();
    nova::submit_copy(copy.range(), last.range());
    nova::flush_deferred();
    if (tape != nullptr) last = tensor(copy);
    if (keep) checkpoints->kept[checkpoints->step] = copy;
  } else if (keep) {
    checkpoints->kept[checkpoints->step] =
        Array(novaphy::DType::vec4, static_cast<size_t>(rows), 1, last.range());
  }
  return last;
}

// `in`: where the step began.
void DiffSolverVBD::keep_velocity(const SimState& in, StepInputs::Checkpoints* checkpoints,
                                  StepScratch scratch) {
  if (!looks_back()) return;
  const nova::Operand qd = nova::operand_of(in.particle_qd);
  const auto rows = static_cast<int64_t>(model()->particle_count());
  const auto keep = [&](const Array& to) {
    const Tensor tensor(to.range(), {rows, 4}, nova::DType::F32);
    keep_velocity_as(qd, tensor);
    return tensor;
  };
  if (checkpoints != nullptr && checkpoints->is_recomputed) {
    if (!checkpoints->kept.contains(-1)) checkpoints->kept[-1] = new_velocities();
    keep(checkpoints->kept.at(-1));
    return;
  }
  const bool is_kept = checkpoints != nullptr && checkpoints->next_is_kept;
  const nova::Tape* const tape = nova::Tape::active();
  if (tape != nullptr || is_kept) {
    const Array to = is_kept || scratch.empty() ? Array(new_velocities()) : scratch[0];
    const Tensor kept = keep(to);
    if (is_kept) checkpoints->kept[checkpoints->step + 1] = to;
    if (tape != nullptr) recorded_velocity_ = {nova::current_capture(), kept};
  }
  const nova::NoGrad no_grad;
  keep(last_velocity_);
}

VbdGradientInfo DiffSolverVBD::gradient_info() const {
  check_replays();
  return steps_->info();
}

// A replay cannot throw: this says afterwards why its results are no numbers.
void DiffSolverVBD::check_replays() const {
  if (failure_->empty()) return;
  fail(ErrorKind::Runtime,
       "DiffSolverVBD: a replay of a captured step failed, its results are NaN: ",
       std::exchange(*failure_, {}));
}

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
                         const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets) {
  check_replays();
  const ExclusiveUse::Scope scope = use(kName);
  check_step(kName, state_in, state_out, control, contacts, dt);
  const auto held = static_cast<size_t>(held_count());
  require(targets == nullptr || (targets->rows() == held && targets->device() == device()),
          ErrorKind::Value, kName, ": targets: expected {", held,
          ", 3}, a position for every held particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");
  begin();
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  StepInputs inputs;
  inputs.control = control;
  inputs.contacts = contacts;
  inputs.forces = nova::operand_of(state_in.particle_f);
  if (targets != nullptr && held != 0) inputs.targets = nova::operand_of(*targets);
  inputs.dt = dt;
  record_step(state_in, state_out, inputs, {});
}

// What replays would find out on the host, whose errors are NaN, they throw before they begin.
void DiffSolverVBD::begin() {
  if (nova::current_capture() == nullptr || !device().is_cpu()) return;
  model()->depend_on_numbers();
  values_.check(*model());
}

bool DiffSolverVBD::begin_rollout(const RolloutInputs&) {
  check_replays();
  begin();
  return model()->particle_count() > 0;
}

void DiffSolverVBD::record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                                StepScratch scratch) {
  const Model& m = *model();
  nova::flush_deferred();
  nova::Tape* const tape = nova::Tape::active();
  auto step = std::make_shared<Step>(model());
  step->steps = steps_;
  step->failure = failure_;
  step->in_use = in_use();
  const bool captured = nova::current_capture() != nullptr, on_device = step->on_device();
  if (on_device && tape == nullptr) {  // nobody goes back through them
    step->contacts = {std::shared_ptr<void>(), inputs.contacts};
  } else if ((captured || on_device) && inputs.contacts != nullptr) {
    const nova::NoGrad no_grad;  // in a capture a copy that every replay makes
    step->contacts = std::make_shared<const Contacts>(inputs.contacts->clone());
  } else {
    step->contacts = kept(inputs.contacts);
  }
  step->q = tensor_of(nova::operand_of(in.particle_q));
  step->qd = tensor_of(nova::operand_of(in.particle_qd));
  step->f = tensor_of(inputs.forces);
  step->target_count = static_cast<size_t>(held_count());
  if (inputs.targets.range != nullptr) {
    step->targets = tensor_of(inputs.targets);
    step->first_target = inputs.first_target;
  }
  const Control* const control = inputs.control;
  step->tri_activation =
      control != nullptr ? control->particle_tri_activation : m.particle_tri_activation;
  step->tet_activation =
      control != nullptr ? control->particle_tet_activation : m.particle_tet_activation;
  step->last = last_velocity(inputs.checkpoints.get());
  step->q_out = out.particle_q;
  step->qd_out = out.particle_qd;
  step->dt = inputs.dt;
  step->implicit = options_.gradient.implicit;
  if (tape != nullptr) step->check_others(*tape, inputs.contacts);
  if (captured) nova::current_capture()->uses(in_use());
  Step::submit_forward(step);
  if (tape == nullptr) return keep_velocity(in, inputs.checkpoints.get(), scratch);
  nova::CustomOp op;
  op.name = "vbd_step";
  for (const Step::Input& input : step->differentiable()) op.inputs.push_back(input.tensor);
  op.outputs = {tensor_of(nova::operand_of(out.particle_q)),
                tensor_of(nova::operand_of(out.particle_qd))};
  op.reads = op.inputs;
  op.reads.push_back(Tensor::view(m.particle_inv_mass));
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) {
    if (nova::current_capture() != nullptr && !step->on_device()) {
      Step::capture_backward(step, {outputs.begin(), outputs.end()}, {to.begin(), to.end()});
    } else {
      step->backward(outputs, to);
    }
  };
  op.jvp = [step](std::span<const Tensor> slopes, std::span<const Tensor> outputs) {
    require(!step->on_device(), ErrorKind::NotImplemented, kName, ": jvp on ",
            step->model->device().str(), " is not there yet");
    if (nova::current_capture() != nullptr) {
      Step::capture_tangent(step, {slopes.begin(), slopes.end()}, {outputs.begin(), outputs.end()});
    } else {
      step->tangent(slopes, outputs);
    }
  };
  op.forward = [step] { Step::submit_forward(step); };
  op.submits_only = captured || (on_device && !step->implicit);
  tape->record_custom(std::move(op));
  keep_velocity(in, inputs.checkpoints.get(), scratch);
}

}  // namespace novaphy::diff
