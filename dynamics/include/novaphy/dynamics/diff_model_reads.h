// The work of an operation before it reads a model: checks the model's numbers, makes its derived
// arrays current, and tells a capture which arrays it holds.
#pragma once

#include <functional>
#include <initializer_list>
#include <string_view>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/export.h"

namespace novaphy::diff {

// `function` starts the messages. ErrorKind::Value: a number of the model that makes no sense.
// While a capture records, a derived array whose source was written (by the capture, say) is
// computed by a recorded launch; every launch of the list begins with the others, and throws
// ErrorKind::Runtime where a number of the model (soft_contact_ke, ...) is another than the one
// recorded.
NOVAPHY_DYNAMICS_API void begin_model_reads(const Model& model, const char* function);

struct NamedArray {
  const char* name;
  const Array& array;
};
// Of arrays of a model that steps read, or would have to, and that no gradient reaches:
// ErrorKind::NotImplemented where one carries a gradient of the active tape. `owner` stands before
// the names.
NOVAPHY_DYNAMICS_API void check_no_gradient(const char* solver,
                                            std::initializer_list<NamedArray> arrays,
                                            const char* owner = "model.");

// Of the model, `control` and `contacts` (null: none) of a step: ErrorKind::NotImplemented, by
// name, where an array carries a gradient of the active tape and has_gradient(its name) is false.
// Positions and velocities of the model are not looked at, because a state starts with copies.
NOVAPHY_DYNAMICS_API void check_other_gradients(
    const char* solver, const Model& model, const Control* control, const Contacts* contacts,
    const std::function<bool(std::string_view)>& has_gradient);

// particle_inv_mass = 1/particle_mass, 0 where the mass is 0, also where something else was
// assigned to it. Not recorded on a tape. Solvers do so themselves where masses were written.
NOVAPHY_DYNAMICS_API void update_inverse_mass(Model& model);

}  // namespace novaphy::diff
