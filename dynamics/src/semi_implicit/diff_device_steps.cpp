#include <optional>
#include <utility>

#include "device_steps.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/semi_implicit/diff_body_step.h"
#include "novaphy/dynamics/semi_implicit/diff_particle_step.h"
#include "novaphy/dynamics/semi_implicit/particle_stability.h"

namespace novaphy {
namespace {

// Steps of SolverSemiImplicit on devices other than the CPU. SolverSemiImplicit checks the
// arguments, and rejects tapes and captures.
class DeviceSteps final : public diff::DiffSolverBase {
 public:
  DeviceSteps(const std::shared_ptr<const Model>& model, const SemiImplicitOptions& options)
      : DiffSolverBase(model),
        particles_(
            *model,
            {.elements = {.springs = true, .triangles = true, .edges = true, .tetrahedra = true},
             .kf_bound = options.particle_kf_bound}),
        bodies_({.solver = "SolverSemiImplicit.step",
                 .angular_damping = options.angular_damping,
                 .friction_law = options.friction_law,
                 .friction_smoothing = *options.friction_smoothing,
                 .penalty_law = options.penalty_law}) {
    require(options.stick_ke == 0.0f, ErrorKind::NotImplemented,
            "SolverSemiImplicit: stick_ke: expected 0 for a model on ", device().str(), ", got ",
            options.stick_ke);
    if (!moves_bodies()) return;
    bodies_.begin(*model);
    joints_.emplace(*model,
                    diff::DiffJoints::Attach{options.joint_attach_ke, options.joint_attach_kd});
  }

  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    begin("SolverSemiImplicit.step", control, contacts, dt);
    if (moves_particles())
      particles_.run(*model(), state_in, state_out, control, contacts, tables_, dt);
    if (!moves_bodies()) return;
    if (total_.rows() == 0) total_ = DeviceArray<SpatialVectorf>(state_in.body_f.rows(), device());
    move_bodies(state_in, state_out, nova::operand_of(state_in.body_f), control, contacts, tables_,
                dt, nova::operand_of(total_));
    if (contacts != nullptr) bodies_.write_contact_forces(*contacts);
  }

 protected:
  std::vector<ScratchSpec> step_scratch() const override {
    std::vector<ScratchSpec> specs = particles_.scratch();
    if (moves_bodies())
      specs.push_back({DType::spatial_vector, static_cast<size_t>(model()->body_count()), 1});
    return specs;
  }
  bool begin_rollout(const RolloutInputs& inputs) override {
    // The control of any step may activate a joint that had no force before.
    const Control* acting = inputs.control(inputs.start());
    for (int32_t t = inputs.start(); t < inputs.stop(); ++t) {
      if (t > inputs.start() && inputs.control(t) == acting) continue;
      acting = inputs.control(t);
      begin("SolverSemiImplicit.rollout", acting, inputs.contacts(), inputs.dt());
      if (!joints_ || joints_->act()) break;
    }
    return moves_particles() || moves_bodies();
  }
  void record_step(const SimState& in, SimState& out, const diff::StepInputs& inputs,
                   StepScratch scratch) override {
    if (inputs.tables != nullptr) inputs.tables->rebuild(*model(), *inputs.contacts, wanted());
    const diff::ContactTables& tables = inputs.tables != nullptr ? *inputs.tables : tables_;
    if (moves_particles()) particles_.record(*model(), in, out, inputs, tables, scratch);
    if (!moves_bodies()) return;
    move_bodies(in, out, inputs.body_forces, inputs.control, inputs.contacts, tables, inputs.dt,
                nova::operand_of(scratch.back()));
    if (inputs.contacts != nullptr && inputs.tables == nullptr)
      bodies_.write_contact_forces(*inputs.contacts);
  }

 private:
  bool moves_particles() const { return model()->particle_count() != 0; }
  bool moves_bodies() const { return model()->body_count() != 0; }
  diff::ContactTables::Wanted wanted() const {
    return {.particles = moves_particles(),
            .particles_on_bodies = particles_.meets_bodies(),
            .bodies = moves_bodies(),
            .of_this_state = false};  // only a gradient needs moving points
  }
  void begin(const char* function, const Control* control, const Contacts* contacts, float dt) {
    particles_.begin(*model(), function);
    if (moves_bodies()) bodies_.begin(*model());
    values_.check(*model());
    if (moves_particles())
      watch_.look(*model(), {.contacts = contacts != nullptr, .kf_bound = particles_.kf_bound()},
                  dt);
    if (joints_) joints_->begin(*model(), control, dt);
    if (contacts != nullptr)
      tables_.update(*model(), *contacts, wanted());
    else
      tables_ = {};
  }
  void move_bodies(const SimState& in, SimState& out, const nova::Operand& body_f,
                   const Control* control, const Contacts* contacts,
                   const diff::ContactTables& tables, float dt, const nova::Operand& total) {
    bodies_.run(*model(), in, out, body_f, joints_ ? &*joints_ : nullptr, control, contacts, tables,
                particles_.wrenches(), dt, total);
  }

  EditedValues values_{"SolverSemiImplicit"};
  ParticleWatch watch_{"SolverSemiImplicit.step"};
  diff::ParticleStep particles_;
  diff::BodyStep bodies_;
  std::optional<diff::DiffJoints> joints_;
  diff::ContactTables tables_;         // tables of the contacts of all steps
  DeviceArray<SpatialVectorf> total_;  // total wrench on each body, for single steps
};

}  // namespace

std::unique_ptr<SolverBase> detail::make_device_steps(const std::shared_ptr<const Model>& model,
                                                      const SemiImplicitOptions& options) {
  if (model->device().is_cpu()) return nullptr;
  return std::make_unique<DeviceSteps>(model, options);
}

}  // namespace novaphy
