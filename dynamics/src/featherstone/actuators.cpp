#include <algorithm>
#include <cmath>
#include <string>

#include "articulation_step.h"
#include "body_actuators.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/featherstone/articulation_functions.h"

namespace novaphy {
namespace detail {
const char* articulation_kernels_source();
}

namespace art = articulation;

namespace {
constexpr int64_t kRowsOfChunk = 256;
}

StepDrives drives_of(const Model& m, const Control* control) {
  return {control ? control->joint_f : m.joint_f,
          control ? control->joint_target_q : m.joint_target_q,
          control ? control->joint_target_qd : m.joint_target_qd,
          m.joint_target_ke,
          m.joint_target_kd,
          m.joint_effort_limit};
}
void read_instead(NamedStepArrays& arrays, const StepDrives& drives) {
  for (size_t i = 0; i < std::size(kActuatedPlaces); ++i)
    arrays[static_cast<size_t>(kActuatedPlaces[i])].array = &drives[i];
}

ActuationArrays Actuators::inputs(const Model& m, const SimState& state, const Control* control) {
  const StepDrives drives = drives_of(m, control);
  return {drives[0],
          drives[1],
          drives[2],
          drives[3],
          drives[4],
          drives[5],
          control ? control->ctrl : m.ctrl,
          state.act,
          m.actuator_gear,
          m.actuator_time,
          m.actuator_gain,
          m.actuator_bias,
          m.actuator_ctrl_range,
          m.actuator_force_range,
          m.actuator_act_range};
}

Actuators::Actuators(const Model& m) : any_(m.actuator_count() > 0) {
  if (!any_) return;
  const UntrackedScope untracked;
  const Device device = m.device();
  std::vector<int32_t> dof = m.actuator_dof.to_host();
  if (std::any_of(dof.begin(), dof.end(), [](int32_t d) { return d < 0; })) {
    pushes_ = true;
    on_bodies_ = std::make_shared<BodyActuators>(m);
    for (size_t k = 0; k < dof.size(); ++k)
      if (dof[k] < 0) dof[k] = on_bodies_->dofs()[k];
  }
  IndexRows lists;
  lists.build(dof, m.joint_dof_count());
  first_ = DeviceArray<int32_t>::from_host(lists.begins(), device);
  order_ = DeviceArray<int32_t>::from_host(lists.all(), device);
  std::vector<int32_t> coord(static_cast<size_t>(m.joint_dof_count()), -1);
  const OnHost<int32_t> type(m.joint_type), q(m.joint_q_start), qd(m.joint_qd_start);
  for (size_t j = 0; j + 1 < q.size(); ++j) {
    const auto of = static_cast<JointType>(type[j]);
    if (quaternion_at(of) == 0) coord[static_cast<size_t>(qd[j])] = -2 - q[j];
    if (!has_axes(of)) continue;
    for (int32_t k = qd[j]; k < qd[j + 1]; ++k) coord[static_cast<size_t>(k)] = q[j] + k - qd[j];
  }
  coord_ = DeviceArray<int32_t>::from_host(coord, device);
}

namespace {

// Checks the values of a model's actuators on the host.
class ActuatorCheck {
 public:
  ActuatorCheck(const Model& m, const char* user) : m_(m), user_(user) {}
  void run() {
    for (size_t k = 0; k < dof_.size(); ++k) {
      check_range("actuator_ctrl_range", ctrl_[k], k);
      check_range("actuator_force_range", force_[k], k);
      check_range("actuator_act_range", act_[k], k);
      const bool has_state = state_[k] >= 0;
      require(has_state ? dynamics_[k] >= 1 && dynamics_[k] <= 3 : dynamics_[k] == 0,
              ErrorKind::Value, user_, ": model.actuator_dynamics[", k, "]: expected ",
              has_state ? "1 to 3 of an actuator with an activation, got "
                        : "0 of an actuator without an activation, got ",
              dynamics_[k]);
      if (dof_[k] >= 0 && is_servo(k)) check_servo(k);
    }
  }

 private:
  template <class... Why>
  void expect(bool good, size_t k, const char* array, Why&&... why) const {
    require(good, ErrorKind::NotImplemented, user_, ": model.", array, "[", k, "] (\"",
            m_.actuator_label[k], "\"): ", why...);
  }
  void check_range(const char* name, const Vec2f& range, size_t k) const {
    require(range.x <= range.y, ErrorKind::Value, user_, ": model.", name, "[", k,
            "]: expected the lower one first, got ", range.x, " and ", range.y);
  }
  bool is_servo(size_t k) const {
    return gain_[k].y != 0.0f || gain_[k].z != 0.0f || bias_[k].y != 0.0f || bias_[k].z != 0.0f;
  }
  void check_servo(size_t k) const {
    const auto dof = static_cast<size_t>(dof_[k]);
    const Vec2f& input = state_[k] < 0 ? ctrl_[k] : act_[k];
    for (const float c : {input.x, input.y})
      expect(bias_[k].y + gain_[k].y * c <= 0.0f && bias_[k].z + gain_[k].z * c <= 0.0f, k,
             "actuator_gain and actuator_bias",
             "expected forces per length and rate <= 0 at every control of its range, got ",
             bias_[k].y + gain_[k].y * c, " and ", bias_[k].z + gain_[k].z * c, " at ", c);
    expect(mode_[dof] == static_cast<int32_t>(JointTargetMode::POSITION_VELOCITY), k,
           "actuator_dof", "expected a degree of freedom of the joint_target_mode ",
           "POSITION_VELOCITY, got ", mode_[dof]);
    const Vec2f& force = force_[k];
    if (force.x <= -kJointUnlimited && force.y >= kJointUnlimited) return;
    expect(force.x > -kJointUnlimited && force.y < kJointUnlimited, k, "actuator_force_range",
           "expected two ends, or none, of a force by length or rate, got ", force.x, " and ",
           force.y);
    bool alone = ke_[dof] == 0.0f && kd_[dof] == 0.0f;
    for (size_t i = 0; i < dof_.size(); ++i)
      alone = alone && (i == k || dof_[i] != dof_[k] || !is_servo(i));
    expect(alone, k, "actuator_force_range",
           "expected none where the degree of freedom has another drive or force by length or "
           "rate, got ",
           force.x, " and ", force.y);
  }

  const Model& m_;
  const char* const user_;
  const OnHost<int32_t> dof_{m_.actuator_dof}, state_{m_.actuator_state},
      dynamics_{m_.actuator_dynamics}, mode_{m_.joint_target_mode};
  const OnHost<float> ke_{m_.joint_target_ke}, kd_{m_.joint_target_kd};
  const OnHost<Vec3f> gain_{m_.actuator_gain}, bias_{m_.actuator_bias};
  const OnHost<Vec2f> ctrl_{m_.actuator_ctrl_range}, force_{m_.actuator_force_range},
      act_{m_.actuator_act_range};
};

}  // namespace

// Finds whether gravity compensation or the fluid acts.
void Actuators::find_forces(const Model& m) {
  const auto acts = [](const DeviceArray<float>& array) {
    const OnHost<float> values(array);
    return std::any_of(values.data(), values.data() + values.size(),
                       [](float x) { return x != 0.0f; });
  };
  has_gravcomp_ = acts(m.body_gravcomp);
  has_fluid_ = acts(m.fluid_density) || acts(m.fluid_viscosity);
}

void Actuators::check(const Model& m, const char* user, bool gradient_by_gravcomp,
                      bool gradient_by_fluid) {
  const Array* const arrays[] = {
      &m.body_gravcomp,        &m.actuator_gain,      &m.actuator_bias,   &m.actuator_ctrl_range,
      &m.actuator_force_range, &m.actuator_act_range, &m.joint_target_ke, &m.joint_target_kd,
      &m.joint_target_mode,    &m.actuator_dynamics,  &m.fluid_density,   &m.fluid_viscosity};
  checked_.resize(std::size(arrays));
  bool same = true;
  for (size_t i = 0; i < std::size(arrays); ++i) same = same && checked_[i].matches(*arrays[i]);
  if (!same) {
    const UntrackedScope untracked;
    find_forces(m);
    if (any_) ActuatorCheck(m, user).run();
    for (size_t i = 0; i < std::size(arrays); ++i) checked_[i].set(*arrays[i]);
  }
  lifts_ = has_gravcomp_ || gradient_by_gravcomp;
  if (!lifts_) depend_on({&m.body_gravcomp});
  flows_ = has_fluid_ || gradient_by_fluid;
  if (!flows_) depend_on({&m.fluid_density, &m.fluid_viscosity});
  if (flows_ && on_bodies_ == nullptr) {
    const UntrackedScope untracked;
    on_bodies_ = std::make_shared<BodyActuators>(m);
  }
}

art::Actuation Actuators::arguments(const Model& m, const ActuationArrays& inputs, float dt) const {
  return {.first = first_,
          .order = order_,
          .coord = coord_,
          .dof = m.actuator_dof,
          .state = m.actuator_state,
          .dynamics = m.actuator_dynamics,
          .in = each<art::kActuationInputs>([&](size_t i) { return Untyped(inputs[i]); }),
          .dt = dt};
}

GravcompInputs gravcomp_inputs(const Model& m, const Array& body_f) {
  return {.world = m.body_world,
          .gravcomp = m.body_gravcomp,
          .mass = m.body_mass,
          .gravity = m.gravity,
          .body_f = Untyped(body_f),
          .worlds = m.world_count()};
}

// The object is never destroyed, because recordings refer to the kernels.
const ActuationKernels& actuation_kernels() {
  static const auto& kernels =
      *new ActuationKernels{{actuation, detail::articulation_kernels_source},
                            {actuation_vjp, detail::articulation_kernels_source},
                            {actuation_jvp, detail::articulation_kernels_source},
                            {gravity_compensation, detail::articulation_kernels_source},
                            {gravity_compensation_vjp, detail::articulation_kernels_source},
                            {gravity_compensation_jvp, detail::articulation_kernels_source}};
  return kernels;
}

namespace {

// Runs rows of a kernel on the host if nothing records them, else as a launch.
template <class A>
void run_step(bool on_host, const Kernel<A>& kernel, const RowKernel<A>& row, int64_t rows,
              int64_t chunk, const A& arguments) {
  if (!on_host) return run(kernel, rows, arguments);
  run_rows(row, rows, in_memory(arguments), chunk);
}

}  // namespace

ActuatedStep::ActuatedStep(const Model& m) : actuators_(m), on_host_(m.device().is_cpu()) {}

ActuatedStep::Read ActuatedStep::begin(const Model& m, const SimState& in, const SimState& out,
                                       const Control* control, float dt, const char* user) {
  actuators_.check(m, user);
  Read read = {drives_of(m, control), in.body_f};
  if (actuators_.any()) {
    const ActuationArrays inputs = Actuators::inputs(m, in, control);
    if (memory_[0].rows() == 0) {
      const UntrackedScope untracked;
      for (size_t i = 0; i < art::kActuated; ++i)
        memory_[i] = DeviceArray<float>(inputs[i].rows(), m.device());
      if (on_host_) memory_[art::kNextActivation] = DeviceArray<float>(in.act.rows(), m.device());
    }
    const ActuationArguments a = {
        .in = actuators_.arguments(m, inputs, dt),
        .out = each<art::kActuationOutputs>([&](size_t i) {
          return Untyped(on_host_ || i < art::kActuated ? memory_[i].range() : out.act.range());
        })};
    run_step(on_host_, actuation_kernels().forward, actuation, m.joint_dof_count(), kRowsOfChunk,
             a);
    std::copy_n(memory_.begin(), read.drives.size(), read.drives.begin());
  }
  if (actuators_.on_bodies() != nullptr) push(m, in, control, read);
  if (actuators_.lifts()) lift(m, read);
  return read;
}

void ActuatedStep::push(const Model& m, const SimState& in, const Control* control, Read& read) {
  const std::shared_ptr<const BodyActuators> bodies = actuators_.on_bodies();
  const BodyActuators& all = *bodies;
  if (pushed_f_.rows() == 0) {
    const UntrackedScope untracked;
    pushed_f_ = DeviceArray<SpatialVectorf>(in.body_f.rows(), m.device());
  }
  const BodyActuationArguments a = {
      .in = all.arguments<float>(m, Actuators::inputs(m, in, control), actuators_.flows(),
                                 in.joint_q, in.joint_qd, all.workspace(),
                                 [](const Array& array) { return Untyped(array); }),
      .body_f = Untyped(read.body_f),
      .out = pushed_f_};
  run_step(on_host_, body_actuation_kernels().forward, body_actuation, all.count(), kTreeRows, a);
  read.body_f = pushed_f_;
}

void ActuatedStep::lift(const Model& m, Read& read) {
  if (body_f_.rows() == 0) {
    const UntrackedScope untracked;
    body_f_ = DeviceArray<SpatialVectorf>(read.body_f.rows(), m.device());
  }
  const GravcompArguments a = {.in = gravcomp_inputs(m, read.body_f), .out = body_f_};
  run_step(on_host_, actuation_kernels().lift, gravity_compensation, m.body_count(), kRowsOfChunk,
           a);
  read.body_f = body_f_;
}

std::vector<float> eval_actuator_forces(const Model& m, const SimState& state,
                                        const Control* control) {
  constexpr const char* name = "eval_actuator_forces";
  require(state.model_id() == m.id() && (control == nullptr || control->model_id() == m.id()),
          ErrorKind::Value, name, ": state, control: expected those of the model");
  if (ArrayObserver* const observer = array_observer()) observer->host_read(name);
  Actuators actuators(m);
  actuators.check(m, name);
  if (!actuators.any()) return {};
  std::vector<std::vector<float>> values;
  for (const Array& array : Actuators::inputs(m, state, control)) {
    values.emplace_back(array.bytes() / sizeof(float));
    if (!values.back().empty()) array.copy_to_host(values.back().data(), array.bytes());
  }
  values.emplace_back(6 * m.actuator_wrench.rows());
  m.actuator_wrench.copy_to_host(static_cast<void*>(values.back().data()),
                                 m.actuator_wrench.bytes());
  const auto number = [&](int32_t input, int32_t row, int32_t k) {
    return art::DualFloat(values[static_cast<size_t>(input)]
                                [static_cast<size_t>(row * art::numbers_of_input(input) + k)]);
  };
  const OnHost<int32_t> dof(m.actuator_dof), activation(m.actuator_state);
  const std::vector<int32_t> coord = actuators.coordinates();
  const OnHost<float> q(state.joint_q), qd(state.joint_qd);
  std::vector<float> forces;
  for (size_t k = 0; k < dof.size(); ++k) {
    const auto i = static_cast<int32_t>(k);
    if (dof[k] < 0) {
      forces.push_back(0.0f);
      continue;
    }
    const auto row = static_cast<size_t>(dof[k]), at = static_cast<size_t>(coord[row]);
    const art::ActuatorForce f =
        art::actuator_force(i, art::actuator_input(i, activation[k], number), number);
    const art::DualFloat length = f.gear * art::DualFloat(q[at]),
                         rate = f.gear * art::DualFloat(qd[row]);
    forces.push_back(
        art::clipped(f.part + f.by_length * length + f.by_rate * rate, f.lower, f.upper).value);
  }
  if (actuators.on_bodies() != nullptr) actuators.on_bodies()->forces(m, state, number, forces);
  return forces;
}

void check_actuator_inputs(const Model& m, const SimState& state, const Control* control,
                           const char* user) {
  const OnHost<float> ctrl(control != nullptr ? control->ctrl : m.ctrl), act(state.act);
  const OnHost<int32_t> activation(m.actuator_state);
  const char* const owner = control != nullptr ? "control" : "model";
  for (size_t k = 0; k < activation.size(); ++k) {
    const std::string name = "] (\"" + m.actuator_label[k] + "\"): expected a finite number, got ";
    require(std::isfinite(ctrl[k]), ErrorKind::Value, user, ": ", owner, ".ctrl[", k, name,
            ctrl[k]);
    const auto row = static_cast<size_t>(std::max(activation[k], 0));
    require(activation[k] < 0 || std::isfinite(act[row]), ErrorKind::Value, user, ": state_in.act[",
            row, name, act[row]);
  }
}

void check_no_body_forces(const Model& m, const char* user) {
  const auto check = [&](const char* name, const DeviceArray<float>& array) {
    const OnHost<float> values(array);
    for (size_t k = 0; k < values.size(); ++k)
      require(values[k] == 0.0f, ErrorKind::NotImplemented, user, ", model.", name,
              ": expected 0, got ", values[k], ": differentiate by DiffFeatherstoneSolver");
  };
  check("body_gravcomp", m.body_gravcomp);
  check("fluid_density", m.fluid_density);
  check("fluid_viscosity", m.fluid_viscosity);
}

void ActuatedStep::finish(const SimState& out) const {
  if (memory_[art::kNextActivation].rows() == 0) return;
  DeviceArray<float> act = out.act;
  act.assign(memory_[art::kNextActivation]);
}

}  // namespace novaphy
