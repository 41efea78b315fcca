// The function table of a GPU backend, which the vendor's plugin exports.
#pragma once

#include "novaphy/abi/backend.h"

namespace novaphy::gpu {

// Returns the function table, as novaphy_backend_query of the plugin does.
const novaphy_backend_api* query(uint32_t host_abi_major, const novaphy_host_api* host,
                                 novaphy_error* error);

}  // namespace novaphy::gpu
