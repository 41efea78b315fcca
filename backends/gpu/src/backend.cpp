#include "backend.h"

#include "device.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

const novaphy_host_api* g_host = nullptr;

novaphy_backend_api make_table() {
  const VendorInfo& v = vendor();
  novaphy_backend_api api{};
  api.struct_size = sizeof(api);
  api.abi_major = NOVAPHY_ABI_MAJOR;
  api.abi_minor = NOVAPHY_ABI_MINOR;
  api.name = v.name;
  api.version = NOVAPHY_VERSION;
  api.device_type = v.device_type;
  api.device_count = device_count;
  api.device_info = device_info;
  api.device_open = device_open;
  api.device_close = device_close;
  api.memory_alloc = memory_alloc;
  api.memory_free = memory_free;
  api.memory_copy = memory_copy;
  api.memory_fill = memory_fill;
  api.stream_create = stream_create;
  api.stream_destroy = stream_destroy;
  api.stream_synchronize = stream_synchronize;
  api.stream_wait = stream_wait;
  api.event_create = event_create;
  api.event_destroy = event_destroy;
  api.event_record = event_record;
  api.event_synchronize = event_synchronize;
  api.event_elapsed = event_elapsed;
  api.module_create = module_create;
  api.module_destroy = module_destroy;
  api.kernel_get = kernel_get;
  api.launch = launch;
  if (v.graphs) {
    api.capture_begin = capture_begin;
    api.capture_end = capture_end;
    api.graph_launch = graph_launch;
    api.graph_destroy = graph_destroy;
  }
  api.kernel_info = kernel_info;
  api.list_create = list_create;
  api.list_launch = list_launch;
  api.list_destroy = list_destroy;
  api.persistent_takes = persistent_takes;
  api.persistent_create = persistent_create;
  api.launch_active = launch_active;
  return api;
}

}  // namespace

const novaphy_host_api* host() { return g_host; }

const novaphy_backend_api* query(uint32_t host_abi_major, const novaphy_host_api* host_api,
                                 novaphy_error* error) {
  if (host_abi_major != NOVAPHY_ABI_MAJOR) {
    fail(error, NOVAPHY_NOT_SUPPORTED,
         "the %s backend was built for ABI major version %u, the host has %u", vendor().name,
         NOVAPHY_ABI_MAJOR, host_abi_major);
    return nullptr;
  }
  if (host_api == nullptr || host_api->struct_size < sizeof(novaphy_host_api)) {
    fail(error, NOVAPHY_INVALID_ARGUMENT, "the host's function table is incomplete");
    return nullptr;
  }
  g_host = host_api;
  static const novaphy_backend_api table = make_table();
  return &table;
}

}  // namespace novaphy::gpu
