// The exported entry of libnovaphy_backend_cuda.so, and the parts specific to CUDA.
#include <cstdlib>

#include "backend.h"
#include "device_source.h"
#include "vendor.h"

namespace novaphy::gpu {

const VendorInfo& vendor() {
  static constexpr VendorInfo kCuda = {
      "cuda",
      NOVAPHY_DEVICE_CUDA,
      "CUDA",
      "sm_",
      cuda_text,
      "NOVAPHY_CUDA_DRIVER",
      [] { return static_cast<const char*>(std::getenv("NOVAPHY_CUDA_DRIVER")); },
      {"libcuda.so.1", "libcuda.so", nullptr, nullptr},
      load_driver,
      12000,
      &kNvrtc,
      NOVAPHY_RUNTIME_COMPILER != 0 ? nullptr : "this plugin was built with NOVA_ENABLE_NVRTC=OFF",
      true,
      32,
  };
  return kCuda;
}

}  // namespace novaphy::gpu

extern "C" __attribute__((visibility("default"))) const novaphy_backend_api* novaphy_backend_query(
    uint32_t host_abi_major, const novaphy_host_api* host, novaphy_error* error) {
  return novaphy::gpu::query(host_abi_major, host, error);
}
