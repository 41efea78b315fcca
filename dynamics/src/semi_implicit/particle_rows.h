// The inverse of a table of particles, as rows: items(p) lists the entries of the table that hold
// p, in ascending order. Negative entries belong to no row.
#pragma once

#include <cstdint>
#include <span>

#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/array_stamp.h"

namespace novaphy {

class ParticleRows {
 public:
  // Builds the rows again if another table comes, or the table was written since the last call.
  // Reuses its memory. ErrorKind::Index, naming `name` and the entry: the particle does not exist.
  // -1 is allowed if `may_be_absent`.
  void update(const Array& table, int32_t particle_count, const char* name, bool may_be_absent);
  void reset();

  bool empty() const { return rows_.empty(); }
  std::span<const int32_t> items(int64_t particle) const { return rows_.items(particle); }

 private:
  IndexRows rows_;
  ArrayStamp table_;
};

}  // namespace novaphy
