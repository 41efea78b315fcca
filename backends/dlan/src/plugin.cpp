// The exported entry of libnovaphy_backend_dlan.so.
#include "backend.h"

extern "C" __attribute__((visibility("default"))) const novaphy_backend_api* novaphy_backend_query(
    uint32_t host_abi_major, const novaphy_host_api* host, novaphy_error* error) {
  return novaphy::gpu::query(host_abi_major, host, error);
}
