// Incidence: the inverse of an index table as CSR. Row r lists, in ascending order, the slots of
// the table that hold r; negative entries belong to no row.
#pragma once

#include <memory>

#include "novaphy/nova/tensor.h"

namespace nova {

struct IncidenceData {
  Operand table;          // {slots, 1} as built from
  uint64_t version = 0;   // of the table then
  uint64_t checksum = 0;  // of the table then, where somebody outside can write it
  bool has_checksum = false;
  uint64_t capture = 0;  // that recorded the building, and whose launches do it; 0: it is done
  int64_t rows = 0;
  std::shared_ptr<Range> offsets;  // i32 {rows + 1}
  std::shared_ptr<Range> items;    // i32 {slots}
};
using Incidence = std::shared_ptr<IncidenceData>;

// Built by a stable counting sort on the table's device; throws ErrorKind::Index for an entry >=
// rows. Inside a capture that writes the table, each replay builds it; of any other table the
// capture needs the present value (see OpList::freeze).
NOVAPHY_NOVA_API Incidence make_incidence(const Operand& table, int64_t rows);
// Builds it again, into the same arrays, from what the table holds now. A launch like any other:
// captured, and run once more with a group of recomputed operations. An adjoint that needs the
// rows as they were before throws. On the CPU, the arrays are as before after an error. Outside of
// a capture that rebuilt it, it counts as outdated until the next call.
NOVAPHY_NOVA_API void rebuild(const Incidence& incidence);
// Whether the table, which may be given apart, still holds what the Incidence was built from, for
// who runs or records on this thread.
NOVAPHY_NOVA_API bool is_current(const IncidenceData& incidence, const Range& table);
// The same as make_incidence; the sorted form is remembered with the table while the table does not
// change.
NOVAPHY_NOVA_API Incidence cached_incidence(const Operand& table, int64_t rows);

// out[r, :] = init[r, :] + sum of source[items[k], :] over row r, in the order of the row-sum rule
// (see <novaphy/abi/program.h>). Null init: starts from +0. out may be init.
NOVAPHY_NOVA_API void row_sum(const Operand& source, const IncidenceData& rows, const Operand* init,
                              const Operand& out);
// Two of them over the same rows; in one launch where the device can.
struct RowSumTerm {
  const Operand* source;
  const Operand* init;
  const Operand* out;
};
NOVAPHY_NOVA_API void row_sums(const RowSumTerm& first, const RowSumTerm& second,
                               const IncidenceData& rows);
// The same with rows of `stride` consecutive items.
NOVAPHY_NOVA_API void row_sum(const Operand& source, int64_t rows, int64_t stride,
                              const Operand* init, const Operand& out);

}  // namespace nova
