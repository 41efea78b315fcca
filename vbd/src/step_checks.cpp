// The checks of a step of VBD: its inputs, its results, and the faults that kernels noted.
#include <algorithm>

#include "novaphy/core/error.h"
#include "step.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

}  // namespace

void Step::check_contacts(const Contacts& contacts, bool has_bodies) const {
  constexpr const char* kContacts = "SolverVBD.step: contacts";
  const Model& m = model_;
  const int32_t count = *contacts.soft_contact_count.data();
  require(count <= contacts.soft_contact_max(), ErrorKind::Runtime, kContacts, ": ", count,
          " were found, but there are slots for ", contacts.soft_contact_max(),
          "; make a pipeline with a larger soft_contact_max");
  const int32_t* particle = contacts.soft_contact_particle.data();
  const int32_t* shape = contacts.soft_contact_shape.data();
  const int32_t* body = m.shape_body.data();
  for (int32_t slot = 0; slot < count; ++slot) {
    require(particle[slot] >= 0 && particle[slot] < m.particle_count(), ErrorKind::Index, kContacts,
            ".soft_contact_particle[", slot, "]: expected 0 to ", m.particle_count() - 1, ", got ",
            particle[slot]);
    require(shape[slot] >= 0 && shape[slot] < m.shape_count(), ErrorKind::Index, kContacts,
            ".soft_contact_shape[", slot, "]: expected 0 to ", m.shape_count() - 1, ", got ",
            shape[slot]);
    require(has_bodies || body[shape[slot]] < 0, ErrorKind::NotImplemented, kContacts, ": slot ",
            slot, " touches shape ", shape[slot], " of body ", body[shape[slot]],
            "; gradients through contacts with bodies are not supported; use SolverVBD or "
            "DiffSolverSemiImplicit");
  }
}

// Raises an error that names the input of the prediction that is not finite.
void Step::check_inputs(const StepInputs& in) {
  const std::span faults(faults_.data(), faults_.rows());
  if (std::all_of(faults.begin(), faults.end(), [](int32_t f) { return f == kNoFault; })) return;
  faults_.zero();
  const auto check = [](const char* name, size_t row, const Vec3f& v) {
    require(is_finite(v), ErrorKind::Value, kName, ": ", name, "[", row,
            "]: expected finite numbers, got ", v.x, ", ", v.y, ", ", v.z);
  };
  for (size_t p = 0; p < faults.size(); ++p) {
    check("state_in.particle_q", p, in.q.data()[p]);
    if (is_kinematic(p)) continue;
    check("state_in.particle_qd", p, in.qd.data()[p]);
    check("state_in.particle_f", p, in.f.data()[p]);
  }
  fail(ErrorKind::Value, kName, ": state_in: the inertial target of a particle overflows float32");
}

// Called before the step writes its results.
void Step::check_positions() const {
  const Vec4f* const x = x_.data();
  for (size_t p = 0; p < x_.rows(); ++p)
    require(is_finite(Vec3f{x[p].x, x[p].y, x[p].z}), ErrorKind::Runtime, kName, ": particle ", p,
            ": its position is no longer finite after ", iterations_run_,
            " iterations; state_out was not written");
}

void Step::check() {
  const UntrackedScope untracked;
  check_trained();
  const std::vector<int32_t> faults = faults_.to_host(), overflow = overflow_.to_host();
  const auto first_of = [&faults](auto&& is_kind) {
    return std::find_if(faults.begin(), faults.end(), is_kind);
  };
  // Report an input that is not finite first, because the input causes the other faults.
  auto found = first_of([](int32_t fault) { return fault != kNoFault && fault != kFaultResult; });
  if (found == faults.end()) found = first_of([](int32_t fault) { return fault != kNoFault; });
  if (found == faults.end() && overflow[0] == 0) return;
  faults_.zero();
  overflow_.zero();
  constexpr const char* kSince = ": a step on a device, or a replay, since this was last asked: ";
  require(overflow[0] == 0, ErrorKind::Runtime, kName, kSince, "contacts: ", overflow[0],
          " were found, but there are slots for ", overflow[1],
          "; make a pipeline with a larger soft_contact_max");
  static constexpr const char* kWhat[] = {"",
                                          "state_in.particle_q: expected finite numbers",
                                          "state_in.particle_qd: expected finite numbers",
                                          "state_in.particle_f: expected finite numbers",
                                          "state_in: the inertial target overflows float32",
                                          "its position did not stay finite"};
  fail(ErrorKind::Runtime, kName, kSince, "particle ", found - faults.begin(), ": ", kWhat[*found],
       "; its results are NaN");
}

}  // namespace novaphy::vbd
