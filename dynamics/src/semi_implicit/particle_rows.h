// The inverse of a table of particles, as rows: items(p) are the entries of the table that hold p,
// in ascending order. Negative entries belong to no row.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/array_stamp.h"

namespace novaphy {

class ParticleRows {
 public:
  // Makes the rows anew if the table is another than at the last call, or was written since. Keeps
  // its memory. ErrorKind::Index, naming `name` and the entry: a particle that is not there (-1 is
  // allowed where `may_be_absent`).
  void update(const Array& table, int32_t particle_count, const char* name, bool may_be_absent);
  void reset();

  bool empty() const { return items_.empty(); }
  std::span<const int32_t> items(int64_t particle) const {
    const int32_t begin = row_begin_[static_cast<size_t>(particle)];
    const int32_t end = row_begin_[static_cast<size_t>(particle) + 1];
    return {items_.data() + begin, static_cast<size_t>(end - begin)};
  }

 private:
  std::vector<int32_t> row_begin_;  // particle_count + 1
  std::vector<int32_t> items_;
  ArrayStamp table_;
};

}  // namespace novaphy
