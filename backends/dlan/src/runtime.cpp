#include "runtime.h"

#include <dlfcn.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <sstream>

#include "ahead.h"
#include "device_source.h"
#include "kernels.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

struct Runtime {
#define NOVAPHY_DLAN_MEMBER(name, result, arguments, symbol, needed) \
  result(*name) arguments = nullptr;
  NOVAPHY_DLAN_FUNCTIONS(NOVAPHY_DLAN_MEMBER)
#undef NOVAPHY_DLAN_MEMBER
};
Runtime g_runtime;

// Directions of copies, as in cudaMemcpyKind.
enum : int { kToDevice = 1, kToHost = 2, kOnDevice = 3 };

// Reads the file NOVAPHY_DLAN_SYMBOLS, with lines "NAME = OTHER": the library exports the function
// NAME as OTHER. An empty OTHER means that the library lacks the function. Lines that begin with #
// are comments.
bool read_symbols(std::map<std::string, std::string>& names, std::string& problem) {
#define NOVAPHY_DLAN_NAME(name, result, arguments, symbol, needed) names[symbol] = symbol;
  NOVAPHY_DLAN_FUNCTIONS(NOVAPHY_DLAN_NAME)
#undef NOVAPHY_DLAN_NAME
  const char* path = std::getenv("NOVAPHY_DLAN_SYMBOLS");
  if (path == nullptr || *path == '\0') return true;
  std::ifstream file(path);
  if (!file) {
    problem = "NOVAPHY_DLAN_SYMBOLS: cannot read " + std::string(path);
    return false;
  }
  int number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    std::istringstream words(line);
    std::string name, equals, other, more;
    words >> name >> equals >> other >> more;
    if (name.empty() || name[0] == '#') continue;
    if (equals != "=" || !more.empty() || !names.contains(name)) {
      problem = "NOVAPHY_DLAN_SYMBOLS: " + std::string(path) + ":" + std::to_string(number) +
                ": expected \"NAME = OTHER\" with a NAME of the list in the guide, got \"" + line +
                "\"";
      return false;
    }
    names[name] = other;
  }
  return true;
}

Context context_of(int device) {
  return reinterpret_cast<Context>(static_cast<intptr_t>(device) + 1);
}
int device_of(Context context) { return static_cast<int>(reinterpret_cast<intptr_t>(context) - 1); }

// Makes another device current for the lifetime of the object.
class On {
 public:
  explicit On(int device) {
    g_runtime.device_now(&before_);
    g_runtime.device_set(device);
  }
  ~On() { g_runtime.device_set(before_); }
  On(const On&) = delete;
  On& operator=(const On&) = delete;

 private:
  int before_ = 0;
};

// Device properties begin with the name. Their total size is unknown, so the buffer is large.
Result name_of(char* name, int size, DeviceId device) {
  constexpr size_t kMost = 64 << 10, kName = 256;
  std::snprintf(name, static_cast<size_t>(size), "%s", vendor().toolkit);
  if (g_runtime.device_properties == nullptr) return kSuccess;
  const auto properties = std::make_unique<char[]>(kMost);
  const Result result = g_runtime.device_properties(properties.get(), device);
  properties[kName] = '\0';
  if (result == kSuccess && properties[0] != '\0')
    std::snprintf(name, static_cast<size_t>(size), "%s", properties.get());
  return result;
}

// The library's fill only repeats one byte. A kernel fills with other patterns.
Result fill_rows(DevicePointer target, size_t pitch, uint32_t pattern, uint32_t bytes, size_t count,
                 Stream stream) {
  const uint32_t byte = pattern & 0xffu;
  const uint32_t mask = bytes == 4 ? ~0u : (1u << 8 * bytes) - 1;
  if (pitch == bytes && (pattern & mask) == (byte * 0x01010101u & mask))
    return g_runtime.fill(target, static_cast<int>(byte), count * bytes, stream);
  constexpr size_t kThreads = 128;
  uint64_t words[] = {target, pitch, count};
  void* arguments[] = {&words[0], &words[1], &pattern, &bytes, &words[2]};
  return g_runtime.launch(fill_stub(),
                          {static_cast<unsigned>((count + kThreads - 1) / kThreads), 1, 1},
                          {kThreads, 1, 1}, arguments, 0, stream);
}

Result copied(DevicePointer target, const void* source, size_t bytes, int kind, Stream stream) {
  return g_runtime.copy(reinterpret_cast<void*>(target), source, bytes, kind, stream);
}

constexpr Result kNotSupported = 801;  // cudaErrorNotSupported

void fit(Driver& d) {
  const Runtime& r = g_runtime;
  d.driver_version = [](int* version) {
    *version = vendor().oldest_driver;
    return g_runtime.version != nullptr ? g_runtime.version(version) : kSuccess;
  };
  d.error_name = [](Result result, const char** name) {
    *name = g_runtime.error_name(result);
    return Result{kSuccess};
  };
  d.error_string = [](Result result, const char** text) {
    *text = g_runtime.error_string(result);
    return Result{kSuccess};
  };
  d.init = [](unsigned) { return Result{kSuccess}; };
  d.device_count = r.device_count;
  d.device_get = [](DeviceId* device, int ordinal) {
    *device = ordinal;
    return Result{kSuccess};
  };
  d.device_name = name_of;
  d.device_attribute = r.device_attribute;
  d.device_memory = [](size_t* bytes, DeviceId device) {
    const On on(device);
    size_t free_bytes = 0;
    return g_runtime.memory_info(&free_bytes, bytes);
  };
  d.context_retain = [](Context* context, DeviceId device) {
    *context = context_of(device);
    return Result{kSuccess};
  };
  d.context_release = [](DeviceId) { return Result{kSuccess}; };
  d.context_set = [](Context context) { return g_runtime.device_set(device_of(context)); };
  d.context_get = [](Context* context) {
    int device = 0;
    const Result result = g_runtime.device_now(&device);
    *context = context_of(device);
    return result;
  };
  d.memory_info = r.memory_info;
  d.alloc = r.alloc;
  d.free = r.free;
  // If the library has no stream-ordered allocation, freeing memory waits for the stream.
  d.alloc_async = r.alloc_async;
  d.free_async = r.free_async;
  if (r.alloc_async == nullptr || r.free_async == nullptr) {
    d.alloc_async = [](DevicePointer* made, size_t bytes, Stream) {
      return g_runtime.alloc(made, bytes);
    };
    d.free_async = [](DevicePointer memory, Stream stream) {
      g_runtime.stream_synchronize(stream);
      return g_runtime.free(memory);
    };
  }
  d.host_alloc = r.host_alloc;
  d.host_free = r.host_free;
  d.host_device_pointer = r.host_device_pointer;
  d.copy_to_device = [](DevicePointer target, const void* source, size_t bytes, Stream stream) {
    return copied(target, source, bytes, kToDevice, stream);
  };
  d.copy_to_host = [](void* target, DevicePointer source, size_t bytes, Stream stream) {
    return g_runtime.copy(target, reinterpret_cast<const void*>(source), bytes, kToHost, stream);
  };
  d.copy_on_device = [](DevicePointer target, DevicePointer source, size_t bytes, Stream stream) {
    return copied(target, reinterpret_cast<const void*>(source), bytes, kOnDevice, stream);
  };
  d.fill_8 = [](DevicePointer target, unsigned char value, size_t count, Stream stream) {
    return g_runtime.fill(target, value, count, stream);
  };
  d.fill_16 = [](DevicePointer target, unsigned short value, size_t count, Stream stream) {
    return fill_rows(target, 2, value, 2, count, stream);
  };
  d.fill_32 = [](DevicePointer target, unsigned value, size_t count, Stream stream) {
    return fill_rows(target, 4, value, 4, count, stream);
  };
  d.fill_2d_32 = [](DevicePointer target, size_t pitch, unsigned value, size_t, size_t count,
                    Stream stream) { return fill_rows(target, pitch, value, 4, count, stream); };
  d.stream_create = r.stream_create;
  d.stream_destroy = r.stream_destroy;
  d.stream_synchronize = r.stream_synchronize;
  d.stream_wait = r.stream_wait;
  d.event_create = r.event_create;
  d.event_destroy = r.event_destroy;
  d.event_record = r.event_record;
  d.event_synchronize = r.event_synchronize;
  d.event_elapsed = r.event_elapsed;
  d.module_load = load_stubs;
  d.module_unload = unload_stubs;
  d.module_function = find_stub;
  d.launch = [](Function function, unsigned bx, unsigned by, unsigned bz, unsigned tx, unsigned ty,
                unsigned tz, unsigned shared, Stream stream, void** arguments, void**) {
    return g_runtime.launch(function, {bx, by, bz}, {tx, ty, tz}, arguments, shared, stream);
  };
  d.blocks_per_unit = r.blocks_per_unit;
  // VendorInfo says that persistent kernels and graphs are not supported.
  d.launch_together = [](Function, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,
                         unsigned, Stream, void**) { return kNotSupported; };
}

}  // namespace

bool load_runtime(Driver& d, void* library) {
  std::map<std::string, std::string> names;
  if (!read_symbols(names, d.problem)) return false;
  std::string missing;
#define NOVAPHY_DLAN_LOAD(name, result, arguments, symbol, needed)                       \
  if (const std::string& own = names[symbol]; !own.empty())                              \
    g_runtime.name = reinterpret_cast<result(*) arguments>(dlsym(library, own.c_str())); \
  if (g_runtime.name == nullptr && missing.empty() && (needed))                          \
    missing = names[symbol].empty() ? symbol : names[symbol];
  NOVAPHY_DLAN_FUNCTIONS(NOVAPHY_DLAN_LOAD)
#undef NOVAPHY_DLAN_LOAD
  fit(d);
  if (!missing.empty()) return lacks_symbol(d, missing.c_str());
  // Opens the library's symbols to all libraries, because kernels register themselves by these
  // symbols.
  Dl_info info{};
  if (dladdr(reinterpret_cast<const void*>(g_runtime.launch), &info) != 0)
    dlopen(info.dli_fname, RTLD_NOW | RTLD_GLOBAL | RTLD_NOLOAD);
  d.problem = kernels_problem();
  if (d.problem.empty() &&
      find_ahead(ahead_key(builtins_source(), Dialect::Program), 0).data == nullptr)
    d.problem =
        "the kernels are of another version: python -m novaphy.backend_check dlan --compile";
  return d.problem.empty();
}

}  // namespace novaphy::gpu
