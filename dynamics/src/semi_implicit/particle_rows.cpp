#include "particle_rows.h"

#include "particle_indices.h"

namespace novaphy {

void ParticleRows::reset() {
  table_.reset();
  rows_.clear();
}

void ParticleRows::update(const Array& table, int32_t particle_count, const char* name,
                          bool may_be_absent) {
  if (table_.matches(table)) return;
  reset();
  const auto* entries = static_cast<const int32_t*>(table.raw());
  const size_t count = table.bytes() / sizeof(int32_t);
  check_corners({entries, count}, particle_count, name, may_be_absent);
  rows_.build({entries, count}, particle_count);
  table_.set(table);
}

}  // namespace novaphy
