// new_state: makes a SimState of a model for Python.
#pragma once

#include <optional>

#include "novaphy/core/sim/model.h"
#ifdef NOVAPHY_PYTHON_DIFF
#include "novaphy/dynamics/diff_solver_base.h"
#endif

namespace novaphy::python {

// Returns a new state with the model's initial values. If it requires gradients, its positions and
// velocities become leaves before a recorded operation reads them.
inline SimState new_state(const Model& model, std::optional<bool> requires_grad) {
  SimState state = model.state(requires_grad);
#ifdef NOVAPHY_PYTHON_DIFF
  diff::make_leaves(state);
#endif
  return state;
}

}  // namespace novaphy::python
