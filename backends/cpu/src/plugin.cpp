// The exported entry of libnovaphy_backend_cpu.so.
#include "native_tables.h"
#include "novaphy/cpu/query.h"

namespace novaphy::cpu {
// The file that cmake/NovaPhyNative.cmake generates defines this function.
std::span<const NativeLevel> compiled_levels();
}  // namespace novaphy::cpu

extern "C" __attribute__((visibility("default"))) const novaphy_backend_api* novaphy_backend_query(
    uint32_t host_abi_major, const novaphy_host_api* host, novaphy_error* error) {
  novaphy::cpu::set_native_levels(novaphy::cpu::compiled_levels());
  return novaphy_cpu_backend_query(host_abi_major, host, error);
}
