#include "novaphy/core/device.h"

#include <atomic>
#include <charconv>
#include <cstdlib>

#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "registry.h"

namespace novaphy {
namespace {

// The default device in one atomic word, so that reading it needs no lock: 0 if not set, otherwise
// 1 + type * 2^32 + ordinal.
std::atomic<uint64_t> g_default{0};

uint64_t pack(Device device) {
  return 1 + ((static_cast<uint64_t>(device.type) << 32) | static_cast<uint32_t>(device.ordinal));
}
Device unpack(uint64_t word) {
  return {static_cast<DeviceType>((word - 1) >> 32),
          static_cast<int32_t>((word - 1) & 0xFFFFFFFFu)};
}

}  // namespace

const char* device_type_name(DeviceType type) {
  switch (type) {
    case DeviceType::CPU:
      return "cpu";
    case DeviceType::CUDA:
      return "cuda";
    case DeviceType::DLAN:
      return "dlan";
  }
  return "unknown";
}

Device Device::parse(std::string_view spec) {
  const auto bad = [&]() {
    fail(ErrorKind::Value,
         "device: expected \"cpu\", \"cuda\", \"cuda:<n>\", \"dlan\" or \"dlan:<n>\", got \"", spec,
         "\"");
  };
  const size_t colon = spec.find(':');
  const std::string_view name = spec.substr(0, colon);
  Device device;
  if (name == "cpu") {
    device.type = DeviceType::CPU;
  } else if (name == "cuda") {
    device.type = DeviceType::CUDA;
  } else if (name == "dlan") {
    device.type = DeviceType::DLAN;
  } else {
    bad();
  }
  if (colon != std::string_view::npos) {
    const std::string_view digits = spec.substr(colon + 1);
    uint32_t ordinal = 0;
    const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), ordinal);
    if (digits.empty() || code != std::errc() || end != digits.data() + digits.size() ||
        ordinal >= static_cast<uint32_t>(kMaxOrdinal) || (device.is_cpu() && ordinal != 0)) {
      bad();
    }
    device.ordinal = static_cast<int32_t>(ordinal);
  }
  return device;
}

std::string Device::str() const {
  if (is_cpu()) return "cpu";
  return std::string(device_type_name(type)) + ":" + std::to_string(ordinal);
}

Device default_device() {
  const uint64_t word = g_default.load(std::memory_order_relaxed);
  if (word != 0) return unpack(word);
  const char* spec = std::getenv("NOVAPHY_DEVICE");
  Device device;
  if (spec != nullptr && *spec != '\0') {
    try {
      device = Device::parse(spec);
    } catch (const Error& error) {
      fail(ErrorKind::Value, "NOVAPHY_DEVICE: ", error.what());
    }
  }
  uint64_t unset = 0;  // keeps a device that another thread has set meanwhile
  g_default.compare_exchange_strong(unset, pack(device));
  return unpack(g_default.load());
}

void set_default_device(Device device) {
  require_device(device);
  g_default.store(pack(device));
}

std::vector<Device> devices() {
  std::vector<Device> result;
  for (const DeviceType type : {DeviceType::CPU, DeviceType::CUDA, DeviceType::DLAN}) {
    const int32_t count = active_device_count(type);
    for (int32_t ordinal = 0; ordinal < count; ++ordinal) result.push_back({type, ordinal});
  }
  return result;
}

bool device_available(Device device) {
  return device.ordinal >= 0 && device.ordinal < active_device_count(device.type);
}

void require_device(Device device) { device_context(device); }

DeviceInfo device_info(Device device) {
  const DeviceContext& context = device_context(device);
  novaphy_error error = make_error();
  novaphy_device_info info{};
  info.struct_size = sizeof(info);
  check(context.api->device_info(device.ordinal, &info, &error), error, "device_info");
  info.name[sizeof(info.name) - 1] = '\0';
  return {.name = info.name,
          .arch = info.arch,
          .units = info.units,
          .total_memory = info.total_memory,
          .free_memory = info.free_memory,
          .host_accessible = (info.capabilities & NOVAPHY_CAP_HOST_ACCESSIBLE) != 0,
          .supports_graph_capture = (info.capabilities & NOVAPHY_CAP_GRAPH_CAPTURE) != 0};
}

void synchronize(Device device) {
  const DeviceContext& context = device_context(device);
  novaphy_error error = make_error();
  check(context.api->stream_synchronize(context.stream, &error), error, "synchronize");
}

}  // namespace novaphy
