#include "novaphy/diff/diff_semi_implicit_solver.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "novaphy/core/error.h"
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
  const ModelCounts& counts = this->model()->counts();
  require(!config.strict || counts.body_count == 0, ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: rigid bodies are not covered yet");
  require(std::isfinite(config.static_contact_margin) && config.static_contact_margin >= 0.0f,
          ErrorKind::Value,
          "DiffSolverConfig, static_contact_margin: expected a finite distance "
          ">= 0, got ",
          config.static_contact_margin);
  if (config.strict) check_elements();
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
  if (!config_.enable_particles || model()->particle_count() == 0) return;
  check_contacts("DiffSemiImplicitSolver.step", contacts);
  particles_.begin(*model(), contacts, "DiffSemiImplicitSolver.step");
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  particles_.run(*model(), state_in, state_out, control, contacts, dt);
}

std::vector<ScratchSpec> DiffSemiImplicitSolver::step_scratch() const {
  return particles_.scratch();
}

bool DiffSemiImplicitSolver::begin_rollout(const RolloutInputs& inputs) {
  if (!config_.enable_particles || model()->particle_count() == 0) return false;
  check_contacts("DiffSemiImplicitSolver.rollout", inputs.contacts());
  particles_.begin(*model(), inputs.contacts(), "DiffSemiImplicitSolver.rollout");
  return true;
}

void DiffSemiImplicitSolver::record_step(const SimState& in, SimState& out,
                                         const StepInputs& inputs, StepScratch scratch) {
  particles_.record(*model(), in, out, inputs, scratch);
}

}  // namespace novaphy::diff
