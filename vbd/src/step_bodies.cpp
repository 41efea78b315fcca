// Steps of VBD in which particles touch rigid bodies, on the host.
#include "bodies.h"
#include "step.h"

namespace novaphy::vbd {
namespace {

// The kernel, with 64 lanes that a thread takes at a time.
constexpr auto kWriteBlock =
    in_chunks(with_rows(vbd_write_block, run_level<&SweepLevel::write_block>), 64);

}  // namespace

// Tells the bodies which particles they touch.
void Step::couple(Bodies& bodies, const Contacts* contacts) {
  const size_t n = x_.rows();
  StepParticles particles;
  particles.slots = &slots_;
  particles.start = {start_.data(), n};
  particles.target = {target_.data(), n};
  particles.moved = {moved_.mutable_data(), n};
  particles.x = {x_.mutable_data(), n};
  particles.inside = damps_inside_ ? 1.0f : 0.0f;
  if (has_contacts_) {
    if (blocks_.rows() == 0) blocks_ = DeviceArray<float>(9 * n, device());
    particles.contact_slots = {contact_items_.data(),
                               static_cast<size_t>(contact_begin_.data()[n])};
    particles.contact_numbers = contact_numbers_.mutable_data();
    particles.blocks = blocks_.data();
  }
  bodies.couple(contacts, particles);
  find_touched_groups(bodies);
}

void Step::find_touched_groups(const Bodies& bodies) {
  const std::span<const VbdTouch> touched = bodies.touched();
  if (touched.empty()) return;
  const std::vector<int32_t>&filled = slots_.filled(), &of_lane = slots_.particles();
  if (touched_filled_.rows() != filled.size())
    touched_filled_ = DeviceArray<int32_t>(filled.size(), device());
  is_touched_.assign(x_.rows(), 0);
  for (const VbdTouch& t : touched) is_touched_[static_cast<size_t>(t.particle)] = 1;
  const auto lanes = static_cast<size_t>(slots_.lanes());
  for (size_t g = 0; g < filled.size(); ++g) {
    const int32_t* const first = of_lane.data() + g * lanes;
    const bool any = std::any_of(first, first + filled[g], [this](int32_t p) {
      return is_touched_[static_cast<size_t>(p)] != 0;
    });
    touched_filled_.mutable_data()[g] = any ? filled[g] : 0;
  }
}

void Step::iterate_bodies(Bodies& bodies) {
  if (!bodies.touched().empty()) {
    VbdSweepArguments touched = sweep(0, colors().back());
    touched.filled = touched_filled_;
    touched.residual = blocks_;
    static const auto& kernel = *new Kernel<VbdSweepArguments>(kWriteBlock, nullptr);
    novaphy::run(kernel, colors().back() * slots_.lanes(), touched);
  }
  bodies.iterate();
}

// Runs the iterations: the bodies move, and then the particles.
void Step::iterate_with(Bodies& bodies) {
  for (size_t k = 0; k < static_cast<size_t>(options_.iterations); ++k) {
    iterate_bodies(bodies);
    list_->iterate(k, k + 1);
  }
}

void Step::end_with(Bodies& bodies) const {
  if (!self_contact_) bodies.balance();
  bodies.check_result();
}

}  // namespace novaphy::vbd
