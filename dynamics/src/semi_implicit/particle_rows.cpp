#include "particle_rows.h"

#include "particle_indices.h"

namespace novaphy {

void ParticleRows::reset() {
  table_.reset();
  items_.clear();
}

void ParticleRows::update(const Array& table, int32_t particle_count, const char* name,
                          bool may_be_absent) {
  if (table_.matches(table)) return;
  reset();
  const auto* entries = static_cast<const int32_t*>(table.raw());
  const size_t count = table.bytes() / sizeof(int32_t);
  check_corners({entries, count}, particle_count, name, may_be_absent);
  // A stable counting sort by particle.
  row_begin_.assign(static_cast<size_t>(particle_count) + 1, 0);
  size_t present = 0;
  for (size_t k = 0; k < count; ++k) {
    if (entries[k] < 0) continue;
    ++row_begin_[static_cast<size_t>(entries[k]) + 1];
    ++present;
  }
  for (size_t p = 1; p < row_begin_.size(); ++p) row_begin_[p] += row_begin_[p - 1];
  items_.resize(present);
  for (size_t k = 0; k < count; ++k) {
    if (entries[k] < 0) continue;
    // row_begin_[p] runs ahead to the row's end and is put back below.
    items_[static_cast<size_t>(row_begin_[static_cast<size_t>(entries[k])]++)] =
        static_cast<int32_t>(k);
  }
  for (size_t p = row_begin_.size() - 1; p > 0; --p) row_begin_[p] = row_begin_[p - 1];
  row_begin_[0] = 0;
  table_.set(table);
}

}  // namespace novaphy
