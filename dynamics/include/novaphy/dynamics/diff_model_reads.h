// Preparations for an operation that reads a model: functions that check the model's values, update
// its derived arrays, and register the arrays with a capture.
#pragma once

#include <functional>
#include <initializer_list>
#include <string_view>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"

namespace novaphy::diff {

// Prepares an operation that reads `model`. Messages begin with `function`. ErrorKind::Value: a
// value of the model is invalid.
//
// In a capture, a derived array is recomputed by a recorded launch if its source was written, for
// example by the capture itself. All other derived arrays are updated at the start of every replay.
// A replay throws ErrorKind::Runtime if a scalar of the model (such as soft_contact_ke) has changed
// since the capture.
NOVAPHY_DYNAMICS_API void begin_model_reads(const Model& model, const char* function);

struct NamedArray {
  const char* name;
  const Array& array;
};
// Throws ErrorKind::NotImplemented if one of the arrays carries a gradient of the active tape. For
// arrays of a model that steps read but that have no gradient. `owner` is the prefix of the names
// in the message.
NOVAPHY_DYNAMICS_API void check_no_gradient(const char* solver,
                                            std::initializer_list<NamedArray> arrays,
                                            const char* owner = "model.");

// Checks the arrays of the model, `control` and `contacts` (null: none) of a step. Throws
// ErrorKind::NotImplemented, with the name, if an array carries a gradient of the active tape and
// has_gradient(name) is false. Positions and velocities of the model are not checked, because a
// state starts with copies of them.
NOVAPHY_DYNAMICS_API void check_other_gradients(
    const char* solver, const Model& model, const Control* control, const Contacts* contacts,
    const std::function<bool(std::string_view)>& has_gradient);

// Sets particle_inv_mass = 1/particle_mass, and 0 for mass 0, and overwrites any other assigned
// value. Not recorded on a tape. Solvers call this function after masses were written.
NOVAPHY_DYNAMICS_API void update_inverse_mass(Model& model);

}  // namespace novaphy::diff
