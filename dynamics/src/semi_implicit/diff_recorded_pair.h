// RecordedPair: a pair of shapes in a step of the current AdjointRecord, for touches whose times
// move. The carried value of a pair is the part of the derivative that goes through the pair. The
// record computes carried values from tangents without the effect of the pair
// (diff_noted_springs.h). The effect of the moved times goes to the pair's row in the step, or in
// the step before or after it.
#pragma once

#include <algorithm>
#include <cstdint>

#include "novaphy/dynamics/diff_adjoint_record.h"

namespace novaphy::diff::detail {

class RecordedPair {
 public:
  RecordedPair(const void* of_step, int32_t first, int32_t second) {
    const AdjointRecord* const record = AdjointRecord::current();
    AdjointRecord::Step* const here = AdjointRecord::entry_of(of_step);
    if (here == nullptr || !record->holds) return;
    const auto at = here - record->steps.data();
    for (const int64_t place : {at, at - 1, at + 1}) {
      if (place < 0 || place >= static_cast<int64_t>(record->steps.size())) continue;
      AdjointRecord::Step& step = here[place - at];
      const auto found = std::ranges::find_if(step.contacts, [&](const AdjointRecord::Contact& c) {
        return std::minmax(c.shape0, c.shape1) == std::minmax(first, second);
      });
      if (found == step.contacts.end()) continue;
      step_ = &step;
      contact_ = &*found;
      is_held_ = record->holds(*found);
      return;
    }
  }
  // Returns whether the present tangent leaves out the pair's effect.
  bool is_held() const { return is_held_; }
  void add(double tangent) const {
    const auto row = static_cast<size_t>(contact_->row);
    if (step_->moved.size() <= row) step_->moved.resize(row + 1);
    step_->moved[row] += static_cast<float>(tangent);
  }

 private:
  AdjointRecord::Step* step_ = nullptr;
  const AdjointRecord::Contact* contact_ = nullptr;
  bool is_held_ = false;
};

}  // namespace novaphy::diff::detail
