// Incidence: the inverse of an index table in CSR form. Row r lists, in ascending order, the slots
// of the table that contain r. Negative entries belong to no row.
#pragma once

#include <memory>

#include "novaphy/nova/tensor.h"

namespace nova {

struct IncidenceData {
  Operand table;          // {slots, 1}, the table that was inverted
  uint64_t version = 0;   // version of the table at that time
  uint64_t checksum = 0;  // checksum of the table at that time, for a table with a writable export
  bool has_checksum = false;
  uint64_t capture = 0;  // the capture whose replay fills the arrays; 0: they are filled already
  int64_t rows = 0;
  std::shared_ptr<Range> offsets;  // i32 {rows + 1}
  std::shared_ptr<Range> items;    // i32 {slots}
};
using Incidence = std::shared_ptr<IncidenceData>;

// Builds an Incidence by a stable counting sort on the table's device. ErrorKind::Index: an entry
// >= rows. If the active capture writes the table, each replay builds the Incidence anew. For any
// other table the capture depends on the present value (see OpList::freeze).
NOVAPHY_NOVA_API Incidence make_incidence(const Operand& table, int64_t rows);
// Rebuilds the arrays in place from the present table. The rebuild is a launch: a capture records
// it, and a group of recomputed operations repeats it. An adjoint that needs the earlier rows
// throws. After an error the arrays on the CPU are unchanged. An Incidence that a capture has
// rebuilt counts as outdated outside of the capture until the next rebuild.
NOVAPHY_NOVA_API void rebuild(const Incidence& incidence);
// Returns whether the arrays belong to the present value of the table, for code that runs or
// records on this thread. `table` may be another view of the table.
NOVAPHY_NOVA_API bool is_current(const IncidenceData& incidence, const Range& table);
// Same as make_incidence, with a cache. The Incidence is stored with the table and reused while the
// table is unchanged.
NOVAPHY_NOVA_API Incidence cached_incidence(const Operand& table, int64_t rows);

// Computes out[r, :] = init[r, :] + sum of source[items[k], :] over row r, in the order of the
// row-sum rule (see <novaphy/abi/program.h>). A null `init` starts from +0. `out` may be `init`.
NOVAPHY_NOVA_API void row_sum(const Operand& source, const IncidenceData& rows, const Operand* init,
                              const Operand& out);
// Computes two row sums over the same rows, in one launch if the device supports that.
struct RowSumTerm {
  const Operand* source;
  const Operand* init;
  const Operand* out;
};
NOVAPHY_NOVA_API void row_sums(const RowSumTerm& first, const RowSumTerm& second,
                               const IncidenceData& rows);
// Computes row sums where each row has `stride` consecutive items.
NOVAPHY_NOVA_API void row_sum(const Operand& source, int64_t rows, int64_t stride,
                              const Operand* init, const Operand& out);

}  // namespace nova
