#include "novaphy/diff/diff_semi_implicit_solver.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/diff/model_reads.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/device_solver.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using nova::Operand;

namespace {
int32_t shapes_for_particles(const Model& model) {
  const std::vector<int32_t> flags = model.shape_flags.to_host();
  return static_cast<int32_t>(std::count_if(flags.begin(), flags.end(), [](int32_t f) {
    return has_flag(f, ShapeFlags::COLLIDE_PARTICLES);
  }));
}
}  // namespace

DiffSemiImplicitSolver::DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                               const DiffSolverConfig& config)
    : DiffSolverBase(std::move(model)), config_(config) {
  const ModelCounts& counts = this->model()->counts();
  require(!config.strict || counts.body_count == 0, ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: rigid bodies are not covered yet");
  rows_.update(*this->model(), config.enable_static_contacts);
  require(std::isfinite(config.static_contact_margin) && config.static_contact_margin >= 0.0f,
          ErrorKind::Value,
          "DiffSolverConfig, static_contact_margin: expected a finite distance "
          ">= 0, got ",
          config.static_contact_margin);
  if (config.strict) check_elements();
  if (config.strict && config.enable_particle_contacts && !config.enable_static_contacts)
    uncovered_shapes_ = shapes_for_particles(*this->model());
  if (config.enable_static_contacts) detail::check_static_shapes(*this->model());
  elements_ = ElementOperators(*this->model(), {.springs = config.enable_springs,
                                                .triangles = config.enable_triangles,
                                                .edges = config.enable_bending,
                                                .tetrahedra = config.enable_tetrahedra});
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

Operand DiffSemiImplicitSolver::add_elements(const Control* control, const Operand& q,
                                             const Operand& qd, const Operand& f,
                                             const Operand& to) {
  if (elements_.empty()) return f;
  elements_.eval(*model(), control, q, qd, f, to);
  return to;
}

// Rebuilt when the contacts changed.
const nova::Incidence* DiffSemiImplicitSolver::contacts_of_particles(const Contacts* contacts) {
  if (!contacts || !config_.enable_particle_contacts || contacts->soft_contact_max() == 0)
    return nullptr;
  const std::shared_ptr<Range>& range = contacts->soft_contact_particle.range();
  if (contacts_of_ && contacts_of_->table.range == range && nova::is_current(*contacts_of_, *range))
    return &contacts_of_;
  if (config_.strict) {
    // Contacts are fixed while a capture records, so this host read is legal there too.
    ArrayObserver* observer = set_array_observer(nullptr);
    const bool overflowed = contacts->overflowed();
    set_array_observer(observer);
    require(!overflowed, ErrorKind::Runtime, "contacts: more contacts were found than the ",
            contacts->soft_contact_max(),
            " slots hold; make the pipeline with a larger soft_contact_max");
  }
  try {
    contacts_of_ = nova::make_incidence(nova::operand_of(contacts->soft_contact_particle),
                                        model()->particle_count());
  } catch (const Error& error) {
    fail(error.kind(), "contacts.soft_contact_particle: ", error.what());
  }
  return &contacts_of_;
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
  begin_model_reads(*model(), "DiffSemiImplicitSolver.step");
  rows_.update(*model(), config_.enable_static_contacts);
  const Operand q = nova::operand_of(state_in.particle_q),
                qd = nova::operand_of(state_in.particle_qd);
  const Operand applied = nova::operand_of(state_in.particle_f);
  const nova::Incidence* contacts_of = contacts_of_particles(contacts);
  const bool static_contacts = config_.enable_static_contacts && config_.enable_particle_contacts;
  // Recorded forces live in memory of the tape, so that the state's own array can be cleared and
  // reused; what a user reads there is a copy.
  const bool recording = nova::Tape::active() != nullptr;
  if (recording) make_leaves(state_in);
  const auto target = [&] {
    if (!recording) return applied;
    Operand total = applied;
    total.range = Storage::allocate(applied.range->bytes(), device(), false)->range();
    return total;
  };
  Operand f = applied;
  if (!elements_.empty()) f = add_elements(control, q, qd, f, target());
  if (contacts_of || static_contacts) {
    const Operand total = target();
    if (static_contacts) {
      eval_static_contact_forces(*model(), rows_, q, qd, f, config_.static_contact_margin, total);
    } else {
      eval_soft_contact_forces(*model(), *contacts, *contacts_of, q, qd, f, total);
    }
    f = total;
  }
  if (f.range != applied.range) {
    nova::submit_copy(applied.range, f.range);
    const Operand recorded[] = {f};
    if (nova::Tape::active()->must_record(recorded))
      nova::Tape::active()->mark_copied(applied.range, "particle_f");
  }
  integrate_particles(*model(), q, qd, f, dt, nova::operand_of(state_out.particle_q),
                      nova::operand_of(state_out.particle_qd));
}

std::vector<ScratchSpec> DiffSemiImplicitSolver::step_scratch() const {
  if (elements_.empty()) return {};
  // The forces on the particles with those of the elements.
  return {{DType::vec3, static_cast<size_t>(model()->particle_count()), 1}};
}

bool DiffSemiImplicitSolver::begin_rollout(const RolloutInputs& inputs) {
  if (!config_.enable_particles || model()->particle_count() == 0) return false;
  check_contacts("DiffSemiImplicitSolver.rollout", inputs.contacts());
  begin_model_reads(*model(), "DiffSemiImplicitSolver.rollout");
  rows_.update(*model(), config_.enable_static_contacts);
  contacts_of_particles(inputs.contacts());  // reads on the host: before anything is deferred
  return true;
}

void DiffSemiImplicitSolver::record_step(const SimState& in, SimState& out,
                                         const StepInputs& inputs, StepScratch scratch) {
  const Operand q = nova::operand_of(in.particle_q), qd = nova::operand_of(in.particle_qd);
  const Operand q_out = nova::operand_of(out.particle_q),
                qd_out = nova::operand_of(out.particle_qd);
  const Operand f = elements_.empty() ? inputs.forces
                                      : add_elements(inputs.control, q, qd, inputs.forces,
                                                     nova::operand_of(scratch[0]));
  if (config_.enable_static_contacts && config_.enable_particle_contacts) {
    step_particles_with_static_contacts(*model(), rows_, q, qd, f, config_.static_contact_margin,
                                        inputs.dt, q_out, qd_out);
  } else if (const nova::Incidence* contacts_of = contacts_of_particles(inputs.contacts)) {
    step_particles(*model(), *inputs.contacts, *contacts_of, q, qd, f, inputs.dt, q_out, qd_out);
  } else {
    integrate_particles(*model(), q, qd, f, inputs.dt, q_out, qd_out);
  }
}

namespace {

// The forward solver's steps, on the devices that only kernels reach.
const bool g_registered = [] {
  set_device_solver([](std::shared_ptr<const Model> model) -> std::unique_ptr<SolverBase> {
    return std::make_unique<DiffSemiImplicitSolver>(std::move(model),
                                                    DiffSolverConfig{.enable_tetrahedra = true,
                                                                     .enable_triangles = true,
                                                                     .enable_springs = true,
                                                                     .enable_bending = true,
                                                                     .strict = false});
  });
  return true;
}();

}  // namespace

}  // namespace novaphy::diff
