// Handwritten kernels: functions over rows, which the host passes as BINARY modules.
#pragma once

#include "novaphy/abi/backend.h"

namespace novaphy::cpu {

// Checks and copies the struct of a BINARY module.
novaphy_status read_row_function(const void* data, uint64_t bytes, novaphy_row_function& function,
                                 novaphy_error* error);
// Runs all rows on the host's threads.
void run_row_function(const novaphy_row_function& function, const novaphy_host_api& host, int64_t n,
                      const uint64_t* arguments);

}  // namespace novaphy::cpu
