#include "novaphy/core/sim/solver_base.h"

#include <cmath>
#include <utility>

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

void check_array(const char* name, const char* which, const Array& array, int32_t rows,
                 Device device) {
  require(array.rows() == static_cast<size_t>(rows) && (rows == 0 || array.device() == device),
          ErrorKind::Value, name, ": ", which, ": expected ", rows, " rows on ", device.str(),
          ", got ", array.rows(), " rows on ", array.device().str());
}

void check_apart(const char* name, const char* which, const Array& a, const Array& b) {
  const bool shared = a.range() && b.range() && a.range()->overlaps(*b.range());
  require(!shared, ErrorKind::Value, name, ": state_out.", which,
          ": expected memory of its own, got memory of state_in");
}

}  // namespace

SolverBase::SolverBase(std::shared_ptr<const Model> model) : model_(std::move(model)) {
  require(model_ != nullptr, ErrorKind::Value, "solver: model: expected a model, got null");
}

SolverBase::~SolverBase() = default;

void SolverBase::notify_model_changed(ModelFlags) {}

void SolverBase::check_step(const char* name, const SimState& state_in, const SimState& state_out,
                            const Control* control, const Contacts* contacts, float dt) const {
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value, name,
          ": dt: expected a finite number > 0, got ", dt);
  require(&state_in != &state_out, ErrorKind::Value, name,
          ": state_out: expected another state than state_in");
  const auto check_model = [&](const char* which, uint64_t id) {
    require(id == model_->id(), ErrorKind::Value, name, ": ", which,
            ": expected one of the solver's model, got one of another model");
  };
  check_model("state_in", state_in.model_id());
  check_model("state_out", state_out.model_id());
  if (control != nullptr) check_model("control", control->model_id());
  if (contacts != nullptr) check_model("contacts", contacts->model_id());

  const int32_t n = model_->particle_count();
  check_array(name, "state_in.particle_q", state_in.particle_q, n, device());
  check_array(name, "state_in.particle_qd", state_in.particle_qd, n, device());
  check_array(name, "state_in.particle_f", state_in.particle_f, n, device());
  check_array(name, "state_out.particle_q", state_out.particle_q, n, device());
  check_array(name, "state_out.particle_qd", state_out.particle_qd, n, device());
  for (const Array* in : {static_cast<const Array*>(&state_in.particle_q),
                          static_cast<const Array*>(&state_in.particle_qd),
                          static_cast<const Array*>(&state_in.particle_f)}) {
    check_apart(name, "particle_q", *in, state_out.particle_q);
    check_apart(name, "particle_qd", *in, state_out.particle_qd);
  }
  check_apart(name, "particle_qd", state_out.particle_q, state_out.particle_qd);
  if (contacts == nullptr) return;
  const int32_t slots = contacts->soft_contact_max();
  check_array(name, "contacts.soft_contact_count", contacts->soft_contact_count, 1, device());
  check_array(name, "contacts.soft_contact_particle", contacts->soft_contact_particle, slots,
              device());
  check_array(name, "contacts.soft_contact_shape", contacts->soft_contact_shape, slots, device());
  check_array(name, "contacts.soft_contact_body_pos", contacts->soft_contact_body_pos, slots,
              device());
  check_array(name, "contacts.soft_contact_body_vel", contacts->soft_contact_body_vel, slots,
              device());
  check_array(name, "contacts.soft_contact_normal", contacts->soft_contact_normal, slots, device());
}

}  // namespace novaphy
