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
    particles_.begin(*model(), contacts, "SolverSemiImplicit.step");
    if (model()->particle_count() != 0)
      particles_.run(*model(), state_in, state_out, control, contacts, dt);
  }

 protected:
  std::vector<ScratchSpec> step_scratch() const override { return particles_.scratch(); }
  bool begin_rollout(const RolloutInputs& inputs) override {
    particles_.begin(*model(), inputs.contacts(), "SolverSemiImplicit.rollout");
    return model()->particle_count() != 0;
  }
  void record_step(const SimState& in, SimState& out, const diff::StepInputs& inputs,
                   StepScratch scratch) override {
    particles_.record(*model(), in, out, inputs, scratch);
  }

 private:
  diff::ParticleStep particles_;
};

}  // namespace

std::unique_ptr<SolverBase> detail::make_device_steps(const std::shared_ptr<const Model>& model) {
  if (model->device().is_cpu()) return nullptr;
  return std::make_unique<DeviceSteps>(model);
}

}  // namespace novaphy
