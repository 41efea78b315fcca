#include "novaphy/core/sim/sim_state.h"

#include <utility>

#include "novaphy/core/sim/model.h"

namespace novaphy {

SimState::SimState(const Model& model) : SimState(model.counts(), model.device(), model.id()) {
  requires_grad = model.requires_grad;
}

SimState::SimState(const ModelCounts& counts, Device device, uint64_t model_id)
    : counts_(counts), device_(device), model_id_(model_id) {
  allocate(counts_, device_);
  // A pose of zeros is no valid transform, so poses start at the identity.
  body_q.fill(Transformf::identity());
}

SimState::SimState(const Model& model, StateFields fields)
    : StateFields(std::move(fields)),
      requires_grad(model.requires_grad),
      counts_(model.counts()),
      device_(model.device()),
      model_id_(model.id()) {
  detail::check_fields<StateFields>(*this, counts_, device_, "SimState");
}

SimState::SimState(const SimState& source, StateFields fields)
    : StateFields(std::move(fields)),
      requires_grad(source.requires_grad),
      counts_(source.counts_),
      device_(source.device_),
      model_id_(source.model_id_) {}

void SimState::clear_forces() {
  visit(*this, [](const FieldInfo& info, Array& array) {
    if (info.role == FieldRole::Applied) array.zero();
  });
}

void SimState::assign(const SimState& source) {
  detail::assign_fields(detail::mutable_fields<StateFields>(*this),
                        detail::const_fields<StateFields>(source), "SimState.assign");
}

SimState SimState::clone() const {
  return SimState(*this, detail::copy_fields<StateFields>(*this, device_));
}

}  // namespace novaphy
