// Who gets what slots compute for the other particles of their elements.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "color_slots.h"

namespace novaphy::vbd {

class Receivers {
 public:
  // Three numbers of a slot, `stride` apart, in the table Adjoint::others[role].
  struct Entry {
    int32_t role = 0;
    int64_t offset = 0;
  };

  void build(const ColorSlots& slots, int32_t particle_count);
  // For a particle, of the slots of the particles of one colour, in the order of role, element and
  // corner, which does not depend on how particles are grouped.
  std::span<const Entry> of(size_t color, int64_t particle) const {
    const size_t row = color * particles_ + static_cast<size_t>(particle);
    return std::span(entries_).subspan(begin_[row], begin_[row + 1] - begin_[row]);
  }

 private:
  size_t particles_ = 0;
  std::vector<size_t> begin_;
  std::vector<Entry> entries_;
};

}  // namespace novaphy::vbd
