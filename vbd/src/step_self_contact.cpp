// Steps of VBD with self-contact, on the host.
#include "bodies.h"
#include "step.h"

namespace novaphy::vbd {

// Runs the iterations of a step with self-contact. Each iteration finds the contacts between
// surfaces again. The sweeps read these contacts and the contacts with shapes from one list.
void Step::iterate_in_contact(Bodies* bodies) {
  SelfContact& contact = *self_contact_;
  const SelfContact::Given given =
      has_contacts_ ? SelfContact::Given{contact_begin_.data(), contact_numbers_.data()}
                    : SelfContact::Given{};
  contact.begin({.start = {start_.data(), start_.rows()},
                 .target = {target_.data(), target_.rows()},
                 .moved = {moved_.mutable_data(), moved_.rows()},
                 .x = {x_.mutable_data(), x_.rows()},
                 .h = tables_->dt,
                 .slip = options_.friction_epsilon * tables_->dt});
  if (bodies != nullptr && !bodies->touched().empty()) {
    contact.find_contacts(given);
    contact.put_numbers(0, colors().back());
  }
  for (int32_t k = 0; k < options_.iterations; ++k) {
    if (k > 0) contact.detect_again();
    if (bodies != nullptr) iterate_bodies(*bodies);
    contact.find_contacts(given);
    for (size_t c = 0; c + 1 < colors().size(); ++c) {
      const int64_t first = colors()[c], end = colors()[c + 1];
      const int64_t lanes = (end - first) * slots_.lanes();
      contact.put_numbers(first, end);
      novaphy::run(kernels().move, lanes, sweep(first, end));
      if (slots_.has_conflicts()) novaphy::run(kernels().commit, lanes, commit(first, next_));
      contact.hold(first, end);
    }
  }
  contact.balance(given);
  contact.find_contacts(given);
  contact.put_numbers(0, colors().back());  // for the residual
  contact.end();
}

}  // namespace novaphy::vbd
