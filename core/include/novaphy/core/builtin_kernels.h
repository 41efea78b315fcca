// The builtin kernels of backends (<novaphy/abi/program.h>) that libraries launch, with their
// argument structs.
#pragma once

#include "novaphy/core/device_kernel.h"

namespace novaphy {

struct ScanArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> in; Writes<int32_t> out;)
};
// Exclusive prefix sum over n rows: each output is the sum of the inputs before it.
NOVAPHY_CORE_API const Kernel<ScanArguments>& exclusive_scan();

struct SortArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> keys; Writes<int32_t> order;)
};
// Stable ascending sort over n rows: `order` is the permutation that sorts the keys.
NOVAPHY_CORE_API const Kernel<SortArguments>& sort_by_key();

struct IncidenceArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> table; Number<int64_t> slots; Writes<int32_t> offsets, items;)
};
// Inverts a table of row indices. For each of n rows, `items` lists in ascending order the slots of
// the table that name the row. The list of a row starts at offsets[row].
NOVAPHY_CORE_API const Kernel<IncidenceArguments>& incidence();

}  // namespace novaphy
