#include "novaphy/diff/diff_semi_implicit_solver.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <string>
#include <utility>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/input_checks.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/semi_implicit/friction_laws.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

namespace {
constexpr std::string_view kSemiImplicitGradients[] = {
    // arrays of the model
    "particle_mass", "particle_radius", "particle_spring_rest_length", "particle_spring_stiffness",
    "particle_spring_damping", "particle_tri_pose", "particle_tri_activation",
    "particle_tri_material", "particle_edge_rest_angle", "particle_edge_material",
    "particle_tet_pose", "particle_tet_activation", "particle_tet_material", "body_com",
    "body_mass", "body_inertia", "shape_material_ke", "shape_material_kd", "shape_material_kf",
    "shape_material_mu", "joint_X_p", "joint_X_c", "joint_axis", "joint_f", "joint_target_q",
    "joint_target_qd", "joint_target_ke", "joint_target_kd", "joint_limit_lower",
    "joint_limit_upper", "joint_limit_ke", "joint_limit_kd", "joint_damping", "joint_effort_limit",
    "gravity",
    // arrays of contacts
    "soft_contact_body_pos", "soft_contact_body_vel", "soft_contact_normal", "rigid_contact_point0",
    "rigid_contact_point1", "rigid_contact_normal", "rigid_contact_margin0",
    "rigid_contact_margin1", "rigid_contact_stiffness", "rigid_contact_damping",
    "rigid_contact_friction"};

int32_t shapes_for_particles(const Model& model) {
  const std::vector<int32_t> flags = model.shape_flags.to_host();
  return static_cast<int32_t>(std::count_if(flags.begin(), flags.end(), [](int32_t f) {
    return has_flag(f, ShapeFlags::COLLIDE_PARTICLES);
  }));
}

// Returns the smoothing (m/s) of the law Huber. With 0 the law has the bits of Viscous.
float huber_smoothing(const DiffSolverConfig& config) {
  require(!is_of_newton(config.friction_law), ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: friction_law: expected \"viscous\" or \"huber\", got \"newton",
          config.friction_law == FrictionLaw::Newton17 ? "17" : "18",
          "\", which is there for comparison in SolverSemiImplicit only");
  const float smoothing = checked_friction_smoothing("DiffSemiImplicitSolver", config.friction_law,
                                                     config.friction_smoothing);
  return config.friction_law == FrictionLaw::Viscous ? 0.0f : smoothing;
}

BodyStepOptions body_options(const DiffSolverConfig& config) {
  return {.solver = "DiffSemiImplicitSolver",
          .static_contacts = config.enable_static_contacts && config.enable_rigid_contacts,
          .angular_damping = config.angular_damping,
          .friction_smoothing = huber_smoothing(config),
          .penalty_law = config.penalty_law};
}

ParticleStepOptions step_options(const DiffSolverConfig& config) {
  const bool static_contacts = config.enable_static_contacts && config.enable_particle_contacts;
  return {.elements = {.springs = config.enable_springs,
                       .triangles = config.enable_triangles,
                       .edges = config.enable_bending,
                       .tetrahedra = config.enable_tetrahedra},
          .contacts = config.enable_particle_contacts && !config.enable_static_contacts,
          .static_contacts = static_contacts,
          .static_contact_margin = config.static_contact_margin,
          .kf_bound = config.particle_kf_bound};
}
}  // namespace

DiffSemiImplicitSolver::DiffSemiImplicitSolver(std::shared_ptr<const Model> model,
                                               const DiffSolverConfig& config)
    : DiffSolverBase(std::move(model)),
      config_(config),
      particles_(*this->model(), step_options(config)),
      bodies_(body_options(config)),
      materials_("DiffSemiImplicitSolver", {.ka = moves_bodies(), .ropes = false}),
      friction_smoothing_(huber_smoothing(config)) {
  materials_.check(*this->model());
  const auto check_option = [](const char* name, float value) {
    require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value,
            "DiffSemiImplicitSolver: ", name, ": expected a finite number >= 0, got ", value);
  };
  check_option("static_contact_margin", config.static_contact_margin);
  require(config.particle_kf_bound >= 0.0f, ErrorKind::Value,
          "DiffSemiImplicitSolver: particle_kf_bound: expected a number >= 0, got ",
          config.particle_kf_bound);
  check_option("angular_damping", config.angular_damping);
  check_penalty_law("DiffSemiImplicitSolver", config.penalty_law, config.friction_law,
                    moves_particles() && config.enable_particle_contacts);
  require(config.penalty_law == PenaltyLaw::Sampled ||
              (!config.enable_static_contacts && config.contact_gradient != DerivativeOf::Motion),
          ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: penalty_law \"mean\" is not supported with ",
          config.enable_static_contacts
              ? "enable_static_contacts; give rollout a pipeline"
              : "contact_gradient \"motion\"; with \"code\" its gradient is that of the motion");
  require(!config.strict || config.enable_particles || this->model()->particle_count() == 0,
          ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: the model has particles, and enable_particles is false: enable "
          "them, or leave them out with strict = false");
  if (config.strict) check_elements();
  if (config.strict) check_bodies();
  if (moves_bodies()) bodies_.begin(*this->model());
  if (moves_bodies() && config.enable_joints)
    joints_.emplace(*this->model(),
                    DiffJoints::Attach{config.joint_attach_ke, config.joint_attach_kd});
  const bool given = config.strict && !config.enable_static_contacts;
  if (given && config.enable_particle_contacts && moves_particles())
    uncovered_shapes_ = shapes_for_particles(*this->model());
  needs_pairs_ = given && config.enable_rigid_contacts && moves_bodies();
  if (config.contact_gradient == DerivativeOf::Motion) {
    constexpr const char* kName = "DiffSemiImplicitSolver: contact_gradient \"motion\"";
    require_cpu(device(), kName);
    require(!config.enable_static_contacts, ErrorKind::NotImplemented, kName,
            " is not supported with enable_static_contacts; give rollout a pipeline, or use "
            "\"code\"");
  }
  if (config.contact_gradient == DerivativeOf::Code || without_motion() != nullptr) return;
  motion_ = std::make_unique<TouchMotion>(
      *this->model(), TouchSettings{.bodies = moves_bodies(),
                                    .particles = moves_particles(),
                                    .rigid = moves_bodies() && config.enable_rigid_contacts,
                                    .soft = moves_particles() && config.enable_particle_contacts,
                                    .jointed = joints_.has_value(),
                                    .elements = particles_.has_elements(),
                                    .smoothing = friction_smoothing_,
                                    .may_hold = config.contact_gradient == DerivativeOf::Auto});
}

// Refuses elements that exert a force but are not enabled.
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
ContactTables::Wanted DiffSemiImplicitSolver::wanted_tables() const {
  const bool given = !config_.enable_static_contacts, particles = given && moves_particles();
  return {.particles = particles && config_.enable_particle_contacts,
          .particles_on_bodies = particles && particles_.meets_bodies(),
          .bodies = given && moves_bodies() && config_.enable_rigid_contacts};
}

void DiffSemiImplicitSolver::check_bodies() const {
  const Model& m = *model();
  require(
      config_.enable_rigid || m.body_count() == 0, ErrorKind::NotImplemented,
      "DiffSemiImplicitSolver: the model has bodies, and enable_rigid is false: enable them, or "
      "leave them out with strict = false");
  const std::vector<int32_t> type = m.joint_type.to_host();
  for (size_t j = 0; j < type.size(); ++j)
    require(!config_.enable_rigid || config_.enable_joints ||
                type[j] == static_cast<int32_t>(JointType::FREE),
            ErrorKind::NotImplemented, "DiffSemiImplicitSolver: model.joint_type[", j,
            "]: expected FREE, because enable_joints is false, got ",
            joint_type_name(static_cast<JointType>(type[j])),
            "; enable them, or leave them out with strict = false");
}

void DiffSemiImplicitSolver::check_contacts(const char* function, const Contacts* contacts,
                                            bool found) const {
  require(!config_.enable_static_contacts || (contacts == nullptr && !found), ErrorKind::Value,
          function, ", contacts: expected none, because enable_static_contacts is true");
  if (contacts != nullptr && config_.strict) check_overflow(*contacts);
  if (contacts != nullptr || found) return;
  const auto check = [&](int32_t count, const char* before, const char* what, const char* option) {
    require(count == 0, ErrorKind::Value, function, ", contacts: expected a Contacts, because ",
            before, count, what,
            ": pass one (or a pipeline to rollout), set enable_static_contacts, or leave them out "
            "with ",
            option, " = false");
  };
  check(uncovered_shapes_, "particles collide with ", " shape(s) of the model",
        "enable_particle_contacts");
  check(needs_pairs_ ? model()->shape_contact_pair_count() : 0, "",
        " pair(s) of shapes of the model may meet", "enable_rigid_contacts");
}

// A given Contacts does not change while a capture records, so a capture allows this host read.
void DiffSemiImplicitSolver::check_overflow(const Contacts& contacts) {
  const UntrackedScope untracked;
  require(!contacts.overflowed(), ErrorKind::Runtime,
          "contacts: more contacts were found than the ", contacts.soft_contact_max(),
          " slots and ", contacts.rigid_contact_max(),
          " rows hold; make the pipeline with a larger soft_contact_max or rigid_contact_max");
}

void DiffSemiImplicitSolver::begin(const char* function, const Control* control,
                                   const Contacts* contacts, bool found, bool of_this_state,
                                   float dt) {
  materials_.check(*model());
  check_contacts(function, contacts, found);
  particles_.begin(*model(), function);
  check_other_gradients(
      "DiffSemiImplicitSolver", *model(), control, contacts, [](std::string_view name) {
        return std::ranges::find(kSemiImplicitGradients, name) != std::end(kSemiImplicitGradients);
      });
  if (moves_bodies()) bodies_.begin(*model());
  values_.check(*model());
  if (moves_particles() && nova::current_capture() == nullptr)
    particle_watch_.look(
        *model(), particle_forces(contacts != nullptr || found || config_.enable_static_contacts),
        dt);
  if (joints_) joints_->begin(*model(), control, dt);
  if (contacts != nullptr) {
    contacts->check_materials(function);
    ContactTables::Wanted wanted = wanted_tables();
    wanted.of_this_state = of_this_state;
    tables_.update(*model(), *contacts, wanted);
  } else {
    tables_ = {};
  }
}

void DiffSemiImplicitSolver::step(SimState& state_in, SimState& state_out, const Control* control,
                                  const Contacts* contacts, float dt) {
  constexpr const char* name = "DiffSemiImplicitSolver.step";
  if (&state_in == &state_out) {
    step(state_in, next_state(name), control, contacts, dt);
    return take_next(state_in);
  }
  require(!nova::current_capture(), ErrorKind::Runtime,
          "DiffSemiImplicitSolver.step inside a ScopedCapture: capture rollout instead "
          "(supports_graph_capture is False)");
  const ExclusiveUse::Scope scope = use(name);
  check_step(name, state_in, state_out, control, contacts, dt);
  check_rotations(name, state_in);
  if (!moves_particles() && !moves_bodies()) return;
  begin(name, control, contacts, false,
        contacts != nullptr && contacts->rigid_contacts_found_from(*model(), state_in.body_q), dt);
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  std::optional<TouchedStep> touched =
      begin_touches(state_in, state_out, nova::operand_of(state_in.particle_f),
                    nova::operand_of(state_in.body_f), control, contacts, dt);
  SimState& from = touched && touched->moved_in ? *touched->moved_in : state_in;
  SimState& to = touched ? touched->to() : state_out;
  // A tape keeps the present memory, so the step needs new memory.
  if (moves_bodies() && (body_f_.rows() == 0 || nova::Tape::active() != nullptr))
    body_f_ = DeviceArray<SpatialVectorf>(state_in.body_f.rows(), device());
  const nova::Operand wrench = moves_bodies() ? nova::operand_of(body_f_) : nova::Operand{};
  note_step(state_in, from, state_out, contacts, tables_, wrench, dt, true);
  if (moves_particles()) {
    particles_.run(*model(), from, to, control, contacts, tables_, dt);
    if (&from != &state_in) {
      nova::submit_copy(state_in.particle_f.range(), from.particle_f.range());
      nova::Tape::active()->mark_untracked(state_in.particle_f.range(),
                                           "particle_f holds a copy of recorded values, through "
                                           "which no gradient would flow; clear it before it is "
                                           "used again");
    }
  }
  if (!moves_bodies()) {
    if (touched) motion_->end(*model(), *touched);
    return;
  }
  bodies_.run(*model(), from, to, nova::operand_of(from.body_f), joints_ ? &*joints_ : nullptr,
              control, contacts, tables_, particles_.wrenches(), dt, wrench);
  if (contacts != nullptr) bodies_.write_contact_forces(*contacts);
  if (touched) motion_->end(*model(), *touched);
}

ParticleForces DiffSemiImplicitSolver::particle_forces(bool contacts) const {
  return {.springs = config_.enable_springs,
          .triangles = config_.enable_triangles,
          .edges = config_.enable_bending,
          .tetrahedra = config_.enable_tetrahedra,
          .contacts = contacts && config_.enable_particle_contacts,
          .kf_bound = config_.particle_kf_bound};
}

float DiffSemiImplicitSolver::stable_dt(const SimState& state, const Contacts& contacts) const {
  constexpr const char* name = "DiffSemiImplicitSolver.stable_dt";
  return std::min(stable_contact_dt(name, *model(), state, contacts, 0.0f),
                  enough_particle_dt(name, *model(), state, &contacts, particle_forces(true)));
}
float DiffSemiImplicitSolver::stable_dt(const SimState& state) const {
  return enough_particle_dt("DiffSemiImplicitSolver.stable_dt", *model(), state, nullptr,
                            particle_forces(config_.enable_static_contacts));
}

std::vector<ScratchSpec> DiffSemiImplicitSolver::step_scratch() const {
  std::vector<ScratchSpec> specs = particles_.scratch();
  const ContactTables::Wanted wanted = wanted_tables();
  if (wanted.bodies || wanted.particles_on_bodies || (joints_ && joints_->act()))
    specs.push_back(
        {novaphy::DType::spatial_vector, static_cast<size_t>(model()->body_count()), 1});
  return specs;
}

bool DiffSemiImplicitSolver::step_writes_kept_memory() const {
  const ContactTables::Wanted wanted = wanted_tables();
  return particles_.has_elements() || wanted.bodies ||
         (moves_particles() && particles_.contacts_move()) ||
         (joints_ && joints_->act());
}

bool DiffSemiImplicitSolver::begin_rollout(const RolloutInputs& inputs) {
  if (!moves_particles() && !moves_bodies()) return false;
  // The control of any step may apply a force to a joint that has no force in the model.
  const Control* acting = inputs.control(inputs.start());
  for (int32_t t = inputs.start(); t < inputs.stop(); ++t) {
    if (t > inputs.start() && inputs.control(t) == acting) continue;
    acting = inputs.control(t);
    begin("DiffSemiImplicitSolver.rollout", acting, inputs.contacts(), inputs.pipeline() != nullptr,
          false, inputs.dt());
    if (joints_ && joints_->act()) break;
  }
  return true;
}

void DiffSemiImplicitSolver::record_step(const SimState& in, SimState& out,
                                         const StepInputs& inputs, StepScratch scratch) {
  if (inputs.tables != nullptr) {
    if (config_.strict && nova::current_capture() == nullptr) {
      nova::flush_deferred();  // runs the launches of the search for contacts
      check_overflow(*inputs.contacts);
    }
    ContactTables::Wanted wanted = wanted_tables();
    // The search has just found the contacts in this state.
    wanted.particles_move = wanted.particles && particles_.contacts_move();
    inputs.tables->rebuild(*model(), *inputs.contacts, wanted);
  }
  const ContactTables& tables = inputs.tables != nullptr ? *inputs.tables : tables_;
  std::optional<TouchedStep> touched = begin_touches(in, out, inputs.forces, inputs.body_forces,
                                                     inputs.control, inputs.contacts, inputs.dt);
  const SimState& from = touched ? touched->from() : in;
  SimState& to = touched ? touched->to() : out;
  const nova::Operand total =
      moves_bodies() && !scratch.empty() ? nova::operand_of(scratch.back()) : nova::Operand{};
  note_step(in, from, out, inputs.contacts, tables, total, inputs.dt,
            inputs.checkpoints == nullptr);
  if (moves_particles()) {
    StepInputs own = inputs;
    if (touched) own.forces = touched->forces;
    particles_.record(*model(), from, to, own, tables, scratch);
  }
  if (moves_bodies()) {
    bodies_.run(*model(), from, to, touched ? touched->body_forces : inputs.body_forces,
                joints_ ? &*joints_ : nullptr, inputs.control, inputs.contacts, tables,
                particles_.wrenches(), inputs.dt, total);
    if (inputs.contacts != nullptr && inputs.tables == nullptr)
      bodies_.write_contact_forces(*inputs.contacts);
  }
  if (touched) motion_->end(*model(), *touched);
}

}  // namespace novaphy::diff
