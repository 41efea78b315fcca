// Preparations of an operation that reads a model: checks the model's numbers, updates its derived
// arrays, and registers the arrays with a capture.
#pragma once

#include <functional>
#include <initializer_list>
#include <string_view>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"

namespace novaphy::diff {

// Prepares an operation. Messages begin with `function`. ErrorKind::Value: a number of the model is
// invalid. In a capture, a recorded launch computes each derived array whose source was written,
// for example by the capture itself. The other derived arrays are updated at the start of every
// launch of the list. Such a launch throws ErrorKind::Runtime if a number of the model (such as
// soft_contact_ke) has changed since.
NOVAPHY_DYNAMICS_API void begin_model_reads(const Model& model, const char* function);

struct NamedArray {
  const char* name;
  const Array& array;
};
// Throws ErrorKind::NotImplemented if one of the arrays carries a gradient of the active tape. The
// arrays belong to a model, are read by steps, and have no gradient. `owner` precedes the names.
NOVAPHY_DYNAMICS_API void check_no_gradient(const char* solver,
                                            std::initializer_list<NamedArray> arrays,
                                            const char* owner = "model.");

// Checks the arrays of the model, `control` and `contacts` (null: none) of a step. Throws
// ErrorKind::NotImplemented with the name of an array that carries a gradient of the active tape
// although has_gradient(name) is false. Positions and velocities of the model are not checked,
// because a state starts with copies.
NOVAPHY_DYNAMICS_API void check_other_gradients(
    const char* solver, const Model& model, const Control* control, const Contacts* contacts,
    const std::function<bool(std::string_view)>& has_gradient);

// Sets particle_inv_mass = 1/particle_mass, and 0 for mass 0, even if another value was assigned.
// Not recorded on a tape. Solvers call this function if masses were written.
NOVAPHY_DYNAMICS_API void update_inverse_mass(Model& model);

}  // namespace novaphy::diff
