#include "novaphy/diff/diff_semi_implicit_solver.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

namespace {
int32_t shapes_for_particles(const Model& model) {
  const std::vector<int32_t> flags = model.shape_flags.to_host();
  return static_cast<int32_t>(std::count_if(flags.begin(), flags.end(), [](int32_t f) {
    return has_flag(f, ShapeFlags::COLLIDE_PARTICLES);
  }));
}

ParticleStepOptions step_options(const DiffSolverConfig& config) {
  const bool static_contacts = config.enable_static_contacts && config.enable_particle_contacts;
  return {.elements = {.springs = config.enable_springs,
                       .triangles = config.enable_triangles,
                       .edges = config.enable_bending,
                       .tetrahedra = config.enable_tetrahedra},
          .contacts = config.enable_particle_contacts,
          .refuse_overflow = config.strict,
          .static_contacts = static_contacts,
          .static_contact_margin = config.static_contact_margin};
}
}  // namespace

DiffSemiImplicitSolver::DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                               const DiffSolverConfig& config)
    : DiffSolverBase(std::move(model)),
      config_(config),
      particles_(*this->model(), step_options(config)) {
  require(std::isfinite(config.static_contact_margin) && config.static_contact_margin >= 0.0f,
          ErrorKind::Value,
          "DiffSolverConfig, static_contact_margin: expected a finite distance "
          ">= 0, got ",
          config.static_contact_margin);
  if (config.strict) check_elements();
  if (config.strict) check_bodies();
  if (moves_bodies()) plane_pairs_.update(*this->model(), has_rigid_contacts());
  if (config.strict && config.enable_particle_contacts && !config.enable_static_contacts)
    uncovered_shapes_ = shapes_for_particles(*this->model());
}

// Elements that exert a force but are not enabled would be left out without a word.
void DiffSemiImplicitSolver::check_elements() const {
  const auto check = [](bool enabled, const char* option, const char* elements,
                        std::initializer_list<const DeviceArray<float>*> strengths) {
    if (enabled) return;
    for (const DeviceArray<float>* strength : strengths) {
      const std::vector<float> values = strength->to_host();
      const bool acts =
          std::any_of(values.begin(), values.end(), [](float v) { return v != 0.0f; });
      require(!acts, ErrorKind::NotImplemented, "DiffSemiImplicitSolver: the model has ", elements,
              " that exert forces, and ", option,
              " is false: enable them, or leave them out with strict = false");
    }
  };
  const Model& m = *model();
  check(config_.enable_springs, "enable_springs", "springs",
        {&m.particle_spring_stiffness, &m.particle_spring_damping});
  check(config_.enable_triangles, "enable_triangles", "triangles", {&m.particle_tri_material});
  check(config_.enable_bending, "enable_bending", "bending edges", {&m.particle_edge_material});
  check(config_.enable_tetrahedra, "enable_tetrahedra", "tetrahedra", {&m.particle_tet_material});
}

bool DiffSemiImplicitSolver::moves_particles() const {
  return config_.enable_particles && model()->particle_count() > 0;
}
bool DiffSemiImplicitSolver::moves_bodies() const {
  return config_.enable_rigid && model()->body_count() > 0;
}
bool DiffSemiImplicitSolver::has_rigid_contacts() const {
  return config_.enable_rigid_contacts && config_.enable_static_contacts;
}

void DiffSemiImplicitSolver::check_bodies() const {
  const Model& m = *model();
  require(
      config_.enable_rigid || m.body_count() == 0, ErrorKind::NotImplemented,
      "DiffSemiImplicitSolver: the model has bodies, and enable_rigid is false: enable them, or "
      "leave them out with strict = false");
  require(!config_.enable_rigid_contacts || config_.enable_static_contacts ||
              m.shape_contact_pair_count() == 0,
          ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: shapes of bodies may meet, and their contacts are covered with "
          "enable_static_contacts only: set it, or leave them out with enable_rigid_contacts = "
          "false");
  const std::vector<int32_t> type = m.joint_type.to_host();
  for (size_t j = 0; j < type.size(); ++j)
    require(!config_.enable_rigid || type[j] == static_cast<int32_t>(JointType::FREE),
            ErrorKind::NotImplemented, "DiffSemiImplicitSolver: model.joint_type[", j,
            "]: expected FREE: there is no gradient through joints that hold bodies, got ",
            joint_type_name(static_cast<JointType>(type[j])),
            "; leave them out with strict = false");
  const std::vector<float> force = m.joint_f.to_host();
  for (size_t k = 0; k < force.size(); ++k)
    require(!config_.enable_rigid || force[k] == 0.0f, ErrorKind::NotImplemented,
            "DiffSemiImplicitSolver: model.joint_f[", k,
            "]: expected 0: forces of free joints are applied by body_f, got ", force[k]);
}

// Those of joints act on bodies, and would be left out without a word.
void DiffSemiImplicitSolver::check_joint_forces(const Control* control) const {
  if (!config_.strict || control == nullptr || !moves_bodies()) return;
  ArrayObserver* const before = set_array_observer(nullptr);
  std::vector<float> force;
  try {
    force = control->joint_f.to_host();
  } catch (...) {
    set_array_observer(before);
    throw;
  }
  set_array_observer(before);
  for (size_t k = 0; k < force.size(); ++k)
    require(force[k] == 0.0f, ErrorKind::NotImplemented, "DiffSemiImplicitSolver: control.joint_f[",
            k, "]: expected 0: forces of free joints are applied by body_f, got ", force[k]);
}

void DiffSemiImplicitSolver::step_bodies(const SimState& in, SimState& out, float dt) {
  plane_pairs_.update(*model(), has_rigid_contacts());
  step_rigid_bodies_with_static_contacts(*model(), plane_pairs_, nova::operand_of(in.body_q),
                                         nova::operand_of(in.body_qd), nova::operand_of(in.body_f),
                                         {.angular_damping = config_.angular_damping,
                                          .friction_smoothing = config_.friction_smoothing,
                                          .dt = dt},
                                         nova::operand_of(out.body_q),
                                         nova::operand_of(out.body_qd));
}

void DiffSemiImplicitSolver::check_contacts(const char* function, const Contacts* contacts) const {
  require(!config_.enable_static_contacts || contacts == nullptr, ErrorKind::Value, function,
          ", contacts: expected none, because enable_static_contacts is true");
  require(contacts != nullptr || uncovered_shapes_ == 0, ErrorKind::Value, function,
          ", contacts: expected a Contacts, because particles collide with ", uncovered_shapes_,
          " shape(s) of the model: pass one, set enable_static_contacts, or leave them out with "
          "enable_particle_contacts = false");
}

void DiffSemiImplicitSolver::step(SimState& state_in, SimState& state_out, const Control* control,
                                  const Contacts* contacts, float dt) {
  require(!nova::current_capture(), ErrorKind::Runtime,
          "DiffSemiImplicitSolver.step inside a ScopedCapture: capture rollout instead "
          "(supports_graph_capture is False)");
  const ExclusiveUse::Scope scope = use("DiffSemiImplicitSolver.step");
  check_step("DiffSemiImplicitSolver.step", state_in, state_out, control, contacts, dt);
  constexpr const char* name = "DiffSemiImplicitSolver.step";
  check_joint_forces(control);
  if (moves_particles()) {
    check_contacts(name, contacts);
    particles_.begin(*model(), contacts, name);
  } else if (moves_bodies()) {
    begin_model_reads(*model(), name);
  }
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  if (moves_particles()) particles_.run(*model(), state_in, state_out, control, contacts, dt);
  if (moves_bodies()) step_bodies(state_in, state_out, dt);
}

std::vector<ScratchSpec> DiffSemiImplicitSolver::step_scratch() const {
  return particles_.scratch();
}

bool DiffSemiImplicitSolver::begin_rollout(const RolloutInputs& inputs) {
  constexpr const char* name = "DiffSemiImplicitSolver.rollout";
  const Control* checked = nullptr;
  for (int32_t t = inputs.start(); t < inputs.stop(); ++t)
    if (inputs.control(t) != checked) check_joint_forces(checked = inputs.control(t));
  if (moves_particles()) {
    check_contacts(name, inputs.contacts());
    particles_.begin(*model(), inputs.contacts(), name);
  } else if (moves_bodies()) {
    begin_model_reads(*model(), name);
  }
  return moves_particles() || moves_bodies();
}

void DiffSemiImplicitSolver::record_step(const SimState& in, SimState& out,
                                         const StepInputs& inputs, StepScratch scratch) {
  if (moves_particles()) particles_.record(*model(), in, out, inputs, scratch);
  if (moves_bodies()) step_bodies(in, out, inputs.dt);
}

}  // namespace novaphy::diff
