// The entry point of the CPU backend where it is linked in. In the plugin, the same objects export
// novaphy_backend_query.
#pragma once

#include "novaphy/abi/backend.h"

extern "C" const novaphy_backend_api* novaphy_cpu_backend_query(uint32_t host_abi_major,
                                                                const novaphy_host_api* host,
                                                                novaphy_error* error);
