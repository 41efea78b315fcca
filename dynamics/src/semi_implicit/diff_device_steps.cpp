#include "device_steps.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/dynamics/semi_implicit/diff_particle_step.h"

namespace novaphy {
namespace {

// SolverSemiImplicit has checked the arguments, and refuses tapes and captures.
class DeviceSteps final : public diff::DiffSolverBase {
 public:
  explicit DeviceSteps(const std::shared_ptr<const Model>& model)
      : DiffSolverBase(model),
        particles_(
            *model,
            {.elements = {.springs = true, .triangles = true, .edges = true, .tetrahedra = true}}) {
  }

  void step(SimState& state_in, SimState& state_out, const Control* control,
            const Contacts* contacts, float dt) override {
    begin(contacts, "SolverSemiImplicit.step");
    if (model()->particle_count() != 0)
      particles_.run(*model(), state_in, state_out, control, contacts, tables_, dt);
  }

 protected:
  std::vector<ScratchSpec> step_scratch() const override { return particles_.scratch(); }
  bool begin_rollout(const RolloutInputs& inputs) override {
    begin(inputs.contacts(), "SolverSemiImplicit.rollout");
    return model()->particle_count() != 0;
  }
  void record_step(const SimState& in, SimState& out, const diff::StepInputs& inputs,
                   StepScratch scratch) override {
    if (inputs.tables != nullptr) inputs.tables->rebuild(*model(), *inputs.contacts, kWanted);
    particles_.record(*model(), in, out, inputs,
                      inputs.tables != nullptr ? *inputs.tables : tables_, scratch);
  }

 private:
  static constexpr diff::ContactTables::Wanted kWanted = {.particles = true};
  void begin(const Contacts* contacts, const char* function) {
    particles_.begin(*model(), function);
    if (contacts != nullptr)
      tables_.update(*model(), *contacts, kWanted);
    else
      tables_ = {};
  }
  diff::ParticleStep particles_;
  diff::ContactTables tables_;  // of the contacts of all steps
};

}  // namespace

std::unique_ptr<SolverBase> detail::make_device_steps(const std::shared_ptr<const Model>& model) {
  if (model->device().is_cpu()) return nullptr;
  return std::make_unique<DeviceSteps>(model);
}

}  // namespace novaphy
