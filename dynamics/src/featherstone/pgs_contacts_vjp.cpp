// What a step notes for its derivatives.
#include <algorithm>

#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;

}  // namespace

void PgsContacts::write_impulses(Vec3f* impulses, float* friction) const {
  for (size_t i = 0; i < friction_.size(); ++i)
    friction[trees_[friction_[i].tree].first_dof + friction_[i].dof] = friction_rows_[i].impulse;
  for (const Row& row : rows_)
    impulses[row.contact] = {row.solver.impulse[0], row.solver.impulse[1], row.solver.impulse[2]};
}

void PgsContacts::add_branches(ContactBranches& to, const ContactRows& contacts,
                               const FeatherstoneOptions& options, bool by_restitution,
                               bool continues) {
  const art::ContactLaw<float> law = contact_law(options, 0.0f);
  art::BranchNotes notes;
  seen_now_.clear();
  for (const Row& row : rows_) {
    art::note_contact(contacts, law, by_restitution, row, notes);
    seen_now_.push_back(art::seen_contact(contacts, row, law.cone));
  }
  for (size_t i = 0; i < friction_.size(); ++i) art::note_friction(friction_rows_[i], notes);
  for (const art::IslandResult& of : island_results_)
    art::raise(notes.all.residual,
               art::relative_residual(of.residual, of.largest, options.pgs_tolerance));
  notes.far = far_.sweeps > 0 ? 1 : 0;
  const auto count = [](const std::vector<SeenContact>& list) {
    return static_cast<int32_t>(list.size());
  };
  if (continues)
    note_events(seen_.data(), count(seen_), seen_now_.data(), count(seen_now_), notes.all);
  std::swap(seen_, seen_now_);
  art::note_step(notes, to);
}

void PgsContacts::push_impulses(float sign) {
  for (Row& row : rows_)
    for (int32_t r = 0; r < 3; ++r) art::push(row.solver, r, sign * row.solver.impulse[r]);
  for (const art::PgsJointFriction<float>& f : friction_rows_)
    for (int32_t k = 0; k < f.width; ++k) f.rates[k] += sign * f.impulse * f.response[k];
}

}  // namespace novaphy
