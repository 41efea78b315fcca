// The function table of the CPU backend: devices, memory, streams, events, modules and launches.
// Streams run their work at once, so an event is only a point in time.
#include <sched.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <new>

#include "module.h"
#include "novaphy/cpu/query.h"
#include "row_function.h"
#include "scan.h"

using novaphy::cpu::fail;

struct novaphy_device {
  const novaphy::cpu::IsaTable* isa;
};
struct novaphy_stream {
  novaphy_device* device;
};
struct novaphy_event {
  std::chrono::steady_clock::time_point time;
  bool recorded = false;
};
// A kernel is a builtin, a function over rows, or a Program.
struct novaphy_kernel {
  const novaphy::cpu::IsaTable* isa = nullptr;
  const novaphy::cpu::Builtin* builtin = nullptr;
  novaphy_row_function function = {};  // a function over rows, unless its `rows` is null
  std::unique_ptr<const novaphy::cpu::Executable> executable;
  uint32_t argument_count = 0;

  const char* name() const {
    if (builtin != nullptr) return builtin->name;
    return executable != nullptr ? executable->program.name.c_str() : function.name;
  }
};
struct novaphy_module {
  novaphy_kernel kernel;
};

namespace novaphy::cpu {

novaphy_status fail(novaphy_error* error, novaphy_status status, const char* format, ...) {
  if (error != nullptr) {
    error->status = status;
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(error->message, sizeof(error->message), format, arguments);
    va_end(arguments);
  }
  return status;
}

namespace {

const novaphy_host_api* g_host = nullptr;

constexpr size_t kAlignment = 256;
constexpr size_t kHugePage = size_t{2} << 20;
constexpr uint64_t kLargeBytes = 2 * kHugePage;

// Converts exceptions to a status, because no exception may cross the C boundary.
template <class Body>
novaphy_status guarded(novaphy_error* error, Body&& body) noexcept {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return fail(error, NOVAPHY_OUT_OF_MEMORY, "out of host memory");
  } catch (const std::exception& exception) {
    return fail(error, NOVAPHY_INTERNAL, "%s", exception.what());
  } catch (...) {
    return fail(error, NOVAPHY_INTERNAL, "unknown exception");
  }
}

// Chooses the instruction set: the set named by NOVAPHY_CPU_ISA, or the best set of the processor.
novaphy_status choose_isa(const IsaTable** isa, novaphy_error* error) {
  struct Level {
    const IsaTable* table;
    bool supported;
  };
#if defined(__x86_64__)
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") &&
                      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
                      __builtin_cpu_supports("avx512vl");
  const Level levels[] = {{isa_avx512(), avx512}, {isa_avx2(), avx2}, {isa_baseline(), true}};
#else
  const Level levels[] = {{isa_baseline(), true}};
#endif
  const char* wanted = std::getenv("NOVAPHY_CPU_ISA");
  for (const Level& level : levels) {
    if (wanted == nullptr || *wanted == '\0') {
      if (!level.supported) continue;
    } else {
      if (std::strcmp(wanted, level.table->name) != 0) continue;
      if (!level.supported) {
        return fail(error, NOVAPHY_NOT_SUPPORTED,
                    "NOVAPHY_CPU_ISA=%s: this processor does not have it", wanted);
      }
    }
    *isa = level.table;
    return NOVAPHY_OK;
  }
  return fail(error, NOVAPHY_INVALID_ARGUMENT,
              "NOVAPHY_CPU_ISA: expected baseline, avx2 or avx512, got '%s'", wanted);
}

novaphy_status device_count(int32_t* count, novaphy_error*) {
  *count = 1;
  return NOVAPHY_OK;
}

void read_cpu_name(char* name, size_t size) {
  std::snprintf(name, size, "CPU");
  std::FILE* file = std::fopen("/proc/cpuinfo", "r");
  if (file == nullptr) return;
  char line[256];
  while (std::fgets(line, sizeof(line), file) != nullptr) {
    if (std::strncmp(line, "model name", 10) != 0) continue;
    const char* value = std::strchr(line, ':');
    if (value != nullptr)
      std::snprintf(name, size, "%.*s", static_cast<int>(std::strcspn(value + 2, "\n")), value + 2);
    break;
  }
  std::fclose(file);
}

novaphy_status check_ordinal(int32_t ordinal, novaphy_error* error) {
  if (ordinal == 0) return NOVAPHY_OK;
  return fail(error, NOVAPHY_INVALID_ARGUMENT, "device ordinal: expected 0, got %d", ordinal);
}

novaphy_status device_info(int32_t ordinal, novaphy_device_info* info, novaphy_error* error) {
  if (const novaphy_status status = check_ordinal(ordinal, error); status != NOVAPHY_OK)
    return status;
  const uint64_t size = info->struct_size;
  if (size < sizeof(novaphy_device_info)) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "device_info: struct_size: expected at least %zu, got %llu",
                sizeof(novaphy_device_info), static_cast<unsigned long long>(size));
  }
  *info = {};
  info->struct_size = size;
  read_cpu_name(info->name, sizeof(info->name));
  cpu_set_t set;
  const bool known = sched_getaffinity(0, sizeof(set), &set) == 0;
  info->units = known ? CPU_COUNT(&set) : static_cast<int32_t>(sysconf(_SC_NPROCESSORS_ONLN));
  const auto page = static_cast<uint64_t>(sysconf(_SC_PAGESIZE));
  info->total_memory = page * static_cast<uint64_t>(sysconf(_SC_PHYS_PAGES));
  info->free_memory = page * static_cast<uint64_t>(sysconf(_SC_AVPHYS_PAGES));
  info->capabilities = NOVAPHY_CAP_HOST_ACCESSIBLE | NOVAPHY_CAP_BINARY_MODULES;
  return NOVAPHY_OK;
}

novaphy_status device_open(int32_t ordinal, novaphy_device** device, novaphy_error* error) {
  if (const novaphy_status status = check_ordinal(ordinal, error); status != NOVAPHY_OK)
    return status;
  const IsaTable* isa = nullptr;
  if (const novaphy_status status = choose_isa(&isa, error); status != NOVAPHY_OK) return status;
  return guarded(error, [&] {
    *device = new novaphy_device{isa};
    return NOVAPHY_OK;
  });
}

void device_close(novaphy_device* device) { delete device; }

novaphy_status memory_alloc(novaphy_device*, int32_t kind, uint64_t bytes, void** pointer,
                            novaphy_error* error) {
  if (kind != NOVAPHY_MEMORY_DEVICE && kind != NOVAPHY_MEMORY_PINNED_HOST) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "memory_alloc: unknown kind %d", kind);
  }
  const uint64_t rounded =
      bytes == 0 ? kAlignment : (bytes + kAlignment - 1) / kAlignment * kAlignment;
  const bool large = bytes >= kLargeBytes;
  *pointer =
      rounded >= bytes ? std::aligned_alloc(large ? kHugePage : kAlignment, rounded) : nullptr;
#if defined(MADV_HUGEPAGE)
  // A rollout reads many arrays at the same time, one page of each. Small pages would cause misses
  // in the translation lookaside buffer. The call is only a hint to the operating system.
  if (large && *pointer != nullptr) (void)madvise(*pointer, rounded, MADV_HUGEPAGE);
#endif
  if (*pointer != nullptr) return NOVAPHY_OK;
  return fail(error, NOVAPHY_OUT_OF_MEMORY, "memory_alloc: no %llu bytes",
              static_cast<unsigned long long>(bytes));
}

void memory_free(novaphy_device*, int32_t, void* pointer) { std::free(pointer); }

novaphy_status memory_copy(novaphy_stream*, int32_t kind, void* target, const void* source,
                           uint64_t bytes, novaphy_error* error) {
  if (kind < NOVAPHY_COPY_DEVICE_TO_DEVICE || kind > NOVAPHY_COPY_DEVICE_TO_HOST) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "memory_copy: unknown kind %d", kind);
  }
  if (bytes != 0) std::memmove(target, source, bytes);
  return NOVAPHY_OK;
}

novaphy_status memory_fill(novaphy_stream*, void* target, uint64_t pattern, uint32_t pattern_bytes,
                           uint64_t bytes, novaphy_error* error) {
  if (pattern_bytes != 1 && pattern_bytes != 2 && pattern_bytes != 4 && pattern_bytes != 8) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "memory_fill: pattern_bytes: expected 1, 2, 4 or 8, got %u", pattern_bytes);
  }
  if (bytes % pattern_bytes != 0) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "memory_fill: %llu bytes are no multiple of the pattern's %u",
                static_cast<unsigned long long>(bytes), pattern_bytes);
  }
  if (bytes == 0) return NOVAPHY_OK;
  // Repeats the pattern to eight bytes, so that one loop serves all sizes.
  uint64_t word = pattern;
  for (uint32_t have = pattern_bytes; have < 8; have *= 2) {
    word = (word & ((uint64_t{1} << (8 * have)) - 1)) | (word << (8 * have));
  }
  auto* out = static_cast<unsigned char*>(target);
  const uint64_t repeated = word & 0xFF;
  if (word == repeated * 0x0101010101010101ull) {
    std::memset(out, static_cast<int>(repeated), bytes);
    return NOVAPHY_OK;
  }
  uint64_t at = 0;
  for (; at + 8 <= bytes; at += 8) std::memcpy(out + at, &word, 8);
  std::memcpy(out + at, &word, bytes - at);
  return NOVAPHY_OK;
}

novaphy_status stream_create(novaphy_device* device, novaphy_stream** stream,
                             novaphy_error* error) {
  return guarded(error, [&] {
    *stream = new novaphy_stream{device};
    return NOVAPHY_OK;
  });
}
void stream_destroy(novaphy_stream* stream) { delete stream; }
novaphy_status stream_synchronize(novaphy_stream*, novaphy_error*) { return NOVAPHY_OK; }
novaphy_status stream_wait(novaphy_stream*, novaphy_event*, novaphy_error*) { return NOVAPHY_OK; }

novaphy_status event_create(novaphy_device*, novaphy_event** event, novaphy_error* error) {
  return guarded(error, [&] {
    *event = new novaphy_event;
    return NOVAPHY_OK;
  });
}
void event_destroy(novaphy_event* event) { delete event; }
novaphy_status event_record(novaphy_event* event, novaphy_stream*, novaphy_error*) {
  event->time = std::chrono::steady_clock::now();
  event->recorded = true;
  return NOVAPHY_OK;
}
novaphy_status event_synchronize(novaphy_event*, novaphy_error*) { return NOVAPHY_OK; }
novaphy_status event_elapsed(novaphy_event* start, novaphy_event* stop, double* seconds,
                             novaphy_error* error) {
  if (!start->recorded || !stop->recorded) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "event_elapsed: the %s event was not recorded",
                start->recorded ? "second" : "first");
  }
  *seconds = std::chrono::duration<double>(stop->time - start->time).count();
  return NOVAPHY_OK;
}

novaphy_status create_program(const IsaTable& isa, const void* data, uint64_t bytes,
                              novaphy_kernel& kernel, novaphy_error* error) {
  if (bytes % sizeof(uint32_t) != 0) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "not a valid Program: %llu bytes are no whole words",
                static_cast<unsigned long long>(bytes));
  }
  // The caller's bytes may be unaligned, so they are copied.
  std::vector<uint32_t> words(bytes / sizeof(uint32_t));
  if (bytes != 0) std::memcpy(words.data(), data, bytes);
  nova::ir::Program program;
  std::string reason;
  if (!nova::ir::deserialize(words, program, reason)) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "%s", reason.c_str());
  }
  kernel.executable = std::make_unique<Executable>(std::move(program), isa);
  kernel.argument_count = kernel.executable->argument_count;
  return NOVAPHY_OK;
}

novaphy_status module_create(novaphy_device* device, int32_t format, const void* data,
                             uint64_t bytes, novaphy_module** module, novaphy_error* error) {
  return guarded(error, [&] {
    auto made = std::make_unique<novaphy_module>();
    made->kernel.isa = device->isa;
    if (format == NOVAPHY_CODE_PROGRAM) {
      const novaphy_status status = create_program(*device->isa, data, bytes, made->kernel, error);
      if (status != NOVAPHY_OK) return status;
    } else if (format == NOVAPHY_CODE_BUILTIN) {
      const std::string_view name(static_cast<const char*>(data), bytes);
      // The name may include its terminating zero.
      made->kernel.builtin = find_builtin(name.substr(0, name.find('\0')));
      if (made->kernel.builtin == nullptr) {
        return fail(error, NOVAPHY_INVALID_ARGUMENT, "unknown builtin '%.*s'",
                    static_cast<int>(std::min<size_t>(name.size(), 64)), name.data());
      }
      made->kernel.argument_count = made->kernel.builtin->argument_count;
    } else if (format == NOVAPHY_CODE_BINARY) {
      const novaphy_status status = read_row_function(data, bytes, made->kernel.function, error);
      if (status != NOVAPHY_OK) return status;
      made->kernel.argument_count = made->kernel.function.argument_count;
    } else {
      return fail(error, NOVAPHY_NOT_SUPPORTED,
                  "the cpu backend takes no modules of code format %d", format);
    }
    *module = made.release();
    return NOVAPHY_OK;
  });
}

void module_destroy(novaphy_module* module) { delete module; }

novaphy_status kernel_get(novaphy_module* module, const char* name, novaphy_kernel** kernel,
                          novaphy_error* error) {
  const novaphy_row_function& function = module->kernel.function;
  const char* const own = function.rows != nullptr ? function.name : "main";
  if (std::strcmp(name, own) != 0) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "kernel_get: expected \"%.64s\", got \"%.64s\"",
                own, name);
  }
  *kernel = &module->kernel;
  return NOVAPHY_OK;
}

novaphy_status launch(novaphy_stream*, novaphy_kernel* kernel, int64_t n, const uint64_t* arguments,
                      uint32_t argument_count, novaphy_error* error) {
  if (argument_count != kernel->argument_count) [[unlikely]] {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "kernel '%s': expected %u argument words, got %u",
                kernel->name(), kernel->argument_count, argument_count);
  }
  if (n <= 0 || n > INT32_MAX) [[unlikely]] {
    if (n == 0) return NOVAPHY_OK;
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "launch: n: expected 0 to %d, got %lld", INT32_MAX,
                static_cast<long long>(n));
  }
  return guarded(error, [&] {
    if (kernel->builtin != nullptr)
      return kernel->builtin->run(*g_host, *kernel->isa, n, arguments, error);
    if (kernel->function.rows != nullptr) {
      run_row_function(kernel->function, *g_host, n, arguments);
      return NOVAPHY_OK;
    }
    return run_executable(*kernel->executable, *g_host, n, arguments, error);
  });
}

novaphy_status kernel_info(novaphy_kernel* kernel, novaphy_kernel_info* info,
                           novaphy_error* error) {
  const uint64_t size = info->struct_size;
  if (size < sizeof(novaphy_kernel_info)) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "kernel_info: struct_size: expected at least %zu, got %llu",
                sizeof(novaphy_kernel_info), static_cast<unsigned long long>(size));
  }
  *info = {};
  info->struct_size = size;
  info->lanes = 1;
  if (kernel->executable == nullptr) {
    info->native = 1;
    std::snprintf(info->isa, sizeof(info->isa), "baseline");
    return NOVAPHY_OK;
  }
  const Executable& executable = *kernel->executable;
  info->hash = nova::ir::hash(executable.program);
  info->native = executable.native.rows != nullptr ? 1 : 0;
  info->lanes = info->native != 0 ? executable.native.lanes : executable.isa.lanes;
  std::snprintf(info->isa, sizeof(info->isa), "%s", executable.isa.name);
  return NOVAPHY_OK;
}

novaphy_status scan_create(novaphy_device*, novaphy_kernel* kernel,
                           const uint64_t* const* arguments, uint32_t argument_count,
                           uint32_t count, novaphy_scan* first, novaphy_scan** scan,
                           novaphy_error* error) {
  if (argument_count != kernel->argument_count) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "scan: expected %u argument words, got %u",
                kernel->argument_count, argument_count);
  }
  return guarded(error, [&] {
    if (kernel->executable == nullptr) return NOVAPHY_NOT_SUPPORTED;
    auto made = novaphy_scan::make(*kernel->executable, {arguments, count}, first);
    if (made == nullptr) return NOVAPHY_NOT_SUPPORTED;
    *scan = made.release();
    return NOVAPHY_OK;
  });
}
novaphy_status scan_launch(novaphy_scan* scan, int64_t begin, int64_t end, novaphy_error* error) {
  return guarded(error, [&] { return scan->run(begin, end, error); });
}
void scan_destroy(novaphy_scan* scan) { delete scan; }

constexpr novaphy_backend_api kApi = {
    sizeof(novaphy_backend_api),
    NOVAPHY_ABI_MAJOR,
    NOVAPHY_ABI_MINOR,
    "cpu",
    NOVAPHY_VERSION,
    NOVAPHY_DEVICE_CPU,
    device_count,
    device_info,
    device_open,
    device_close,
    memory_alloc,
    memory_free,
    memory_copy,
    memory_fill,
    stream_create,
    stream_destroy,
    stream_synchronize,
    stream_wait,
    event_create,
    event_destroy,
    event_record,
    event_synchronize,
    event_elapsed,
    module_create,
    module_destroy,
    kernel_get,
    launch,
    nullptr,  // capture: the runtime replays launches itself
    nullptr,
    nullptr,
    nullptr,
    kernel_info,
    nullptr,  // lists: the runtime runs blocks of rows itself
    nullptr,
    nullptr,
    scan_create,
    scan_launch,
    scan_destroy,
    nullptr,  // persistent kernels
    nullptr,
    nullptr,  // launch_active: the host reads the number of rows
};

}  // namespace
}  // namespace novaphy::cpu

extern "C" const novaphy_backend_api* novaphy_cpu_backend_query(uint32_t host_abi_major,
                                                                const novaphy_host_api* host,
                                                                novaphy_error* error) {
  if (host_abi_major != NOVAPHY_ABI_MAJOR) {
    fail(error, NOVAPHY_NOT_SUPPORTED,
         "the cpu backend was built for ABI major version %u, the host has %u", NOVAPHY_ABI_MAJOR,
         host_abi_major);
    return nullptr;
  }
  if (host == nullptr || host->struct_size < sizeof(novaphy_host_api) ||
      host->parallel_for == nullptr) {
    fail(error, NOVAPHY_INVALID_ARGUMENT, "the host's function table is incomplete");
    return nullptr;
  }
  novaphy::cpu::g_host = host;
  return &novaphy::cpu::kApi;
}
