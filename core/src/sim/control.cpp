#include "novaphy/core/sim/control.h"

#include <utility>

#include "novaphy/core/sim/model.h"

namespace novaphy {

Control::Control(const Model& model) : Control(model.counts(), model.device(), model.id()) {
  requires_grad = model.requires_grad;
}

Control::Control(const ModelCounts& counts, Device device, uint64_t model_id)
    : counts_(counts), device_(device), model_id_(model_id) {
  allocate(counts_, device_);
}

Control::Control(const Control& source, ControlFields fields)
    : ControlFields(std::move(fields)),
      requires_grad(source.requires_grad),
      counts_(source.counts_),
      device_(source.device_),
      model_id_(source.model_id_) {}

void Control::clear() {
  for (const detail::MutableField& field : detail::mutable_fields<ControlFields>(*this))
    field.array->zero();
}

void Control::assign(const Control& source) {
  detail::assign_fields(detail::mutable_fields<ControlFields>(*this),
                        detail::const_fields<ControlFields>(source), "Control.assign");
}

Control Control::clone() const {
  return Control(*this, detail::copy_fields<ControlFields>(*this, device_));
}

}  // namespace novaphy
