// How often this thread has called operator new, wherever in the process. Whatever makes a tensor,
// a storage or a list comes through there.
#pragma once

#include <cstdint>

namespace novaphy::testing {

int64_t allocations();

}  // namespace novaphy::testing
