// The builtins of backends (<novaphy/abi/program.h>) that libraries launch, with their arguments.
#pragma once

#include "novaphy/core/device_kernel.h"

namespace novaphy {

struct ScanArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> in; Writes<int32_t> out;)
};
// Over n rows: the sum of those before each.
NOVAPHY_CORE_API const Kernel<ScanArguments>& exclusive_scan();

struct SortArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> keys; Writes<int32_t> order;)
};
// Over n rows: the permutation that sorts the keys, ascending and stable.
NOVAPHY_CORE_API const Kernel<SortArguments>& sort_by_key();

struct IncidenceArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> table; Number<int64_t> slots; Writes<int32_t> offsets, items;)
};
// Over n rows: the slots of the table that name each row, ascending, from offsets[row] on.
NOVAPHY_CORE_API const Kernel<IncidenceArguments>& incidence();

}  // namespace novaphy
