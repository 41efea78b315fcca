// ParticleRows: the inverse of a table of particle indices. items(p) lists the entries of the table
// with the value p, in ascending order. Negative entries are in no list.
#pragma once

#include <cstdint>
#include <span>

#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/array_stamp.h"

namespace novaphy {

class ParticleRows {
 public:
  // Builds the lists again if another table is given, or if the table was written since the last
  // call. Reuses its memory. ErrorKind::Index, with `name` and the entry: the particle does not
  // exist. -1 is allowed if `may_be_absent`.
  void update(const Array& table, int32_t particle_count, const char* name, bool may_be_absent);
  void reset();

  bool empty() const { return rows_.empty(); }
  std::span<const int32_t> items(int64_t particle) const { return rows_.items(particle); }

 private:
  IndexRows rows_;
  ArrayStamp table_;
};

}  // namespace novaphy
