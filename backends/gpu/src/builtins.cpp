// The host side of the builtins: their modules, launches and scratch memory. Scratch memory is
// allocated and freed in stream order, so a captured builtin also captures its scratch memory.
#include <algorithm>
#include <bit>
#include <limits>
#include <map>
#include <utility>

#include "module.h"

namespace novaphy::gpu {
namespace {

struct Functions {
  Module module = nullptr;
  Function row_sum = nullptr, sum_chunks = nullptr, sum_last = nullptr, scan = nullptr,
           sort_count = nullptr, sort_place = nullptr, incidence_count = nullptr,
           checksum = nullptr;
};

// The kernels of the builtins, compiled at the first use on a device and kept until the process
// ends.
std::mutex g_mutex;
std::map<const novaphy_device*, Functions> g_functions;

novaphy_status load_functions(novaphy_device* device, const Functions** result,
                              novaphy_error* error) {
  const std::lock_guard lock(g_mutex);
  Functions& f = g_functions[device];
  *result = &f;
  if (f.module != nullptr) return NOVAPHY_OK;
  const Use use(device);
  Module module = nullptr;
  novaphy_status status =
      load_code(device, builtins_source(), "builtins", Dialect::Program, &module, error);
  if (status != NOVAPHY_OK) return status;
  const std::pair<Function*, const char*> entries[] = {{&f.row_sum, "row_sum_f32"},
                                                       {&f.sum_chunks, "row_sum_chunks"},
                                                       {&f.sum_last, "row_sum_last"},
                                                       {&f.scan, "exclusive_scan_i32"},
                                                       {&f.sort_count, "sort_count"},
                                                       {&f.sort_place, "sort_place"},
                                                       {&f.incidence_count, "incidence_count"},
                                                       {&f.checksum, "checksum_u64"}};
  for (const auto& [function, name] : entries) {
    status = check(device, driver().module_function(function, module, name), name, error);
    if (status != NOVAPHY_OK) {
      driver().module_unload(module);
      return status;
    }
  }
  f.module = module;
  return NOVAPHY_OK;
}

// Returns the functions of the builtins for a device. They are loaded, because a kernel exists.
const Functions& functions_of(const novaphy_device* device) {
  const std::lock_guard lock(g_mutex);
  return g_functions.find(device)->second;
}

class Scratch {
 public:
  explicit Scratch(novaphy_stream* stream) : stream_(stream) {}
  ~Scratch() {
    if (memory_ != 0) driver().free_async(memory_, stream_->stream);
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  novaphy_status allocate(uint64_t words, const char* what, novaphy_error* error) {
    return check(stream_->device,
                 driver().alloc_async(&memory_, std::max<uint64_t>(words, 1) * 4, stream_->stream),
                 what, error);
  }
  DevicePointer words(uint64_t first) const { return memory_ + 4 * first; }

 private:
  novaphy_stream* stream_;
  DevicePointer memory_ = 0;
};

struct RowSumArguments {
  uint64_t source, offsets, items, init, out;
  int64_t width, stride, n;
};

novaphy_status long_row_sum(novaphy_stream* stream, const RowSumArguments& a,
                            novaphy_error* error) {
  constexpr int64_t kChunk = NOVAPHY_ROW_SUM_CHUNK, kThreads = 128;
  const Functions& f = functions_of(stream->device);
  const auto chunks_of = [](int64_t count) { return (count + kChunk - 1) / kChunk; };
  int64_t words = 0;
  for (int64_t count = a.stride; count > kChunk; count = chunks_of(count))
    words += chunks_of(count) * a.width;
  Scratch scratch(stream);
  novaphy_status status = scratch.allocate(static_cast<uint64_t>(words), "row_sum_f32", error);
  uint64_t source = a.source, target = scratch.words(0);
  int64_t count = a.stride, width = a.width;
  while (status == NOVAPHY_OK && count > kChunk) {
    void* pointers[] = {&source, &target, &count, &width};
    const int64_t chunks = chunks_of(count);
    status = launch_function(stream, f.sum_chunks, (chunks + kThreads - 1) / kThreads * width,
                             kThreads, pointers, "row_sum_f32", error);
    source = target;
    target += 4 * static_cast<uint64_t>(chunks * width);
    count = chunks;
  }
  if (status != NOVAPHY_OK) return status;
  uint64_t init = a.init, out = a.out;
  void* pointers[] = {&source, &init, &out, &count, &width};
  return launch_function(stream, f.sum_last, 1, kThreads, pointers, "row_sum_f32", error);
}

novaphy_status row_sum(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                       const uint64_t* a, novaphy_error* error) {
  RowSumArguments arguments = {
      a[0], a[1], a[2], a[3], a[4], static_cast<int64_t>(a[5]), static_cast<int64_t>(a[6]), n};
  if (arguments.width < 1)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "row_sum_f32: width: expected at least 1, got %lld",
                static_cast<long long>(arguments.width));
  if (arguments.offsets == 0 && arguments.stride < 0)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "row_sum_f32: stride: expected at least 0, got %lld",
                static_cast<long long>(arguments.stride));
  constexpr int64_t kVeryLong = 16384;
  if (n == 1 && arguments.offsets == 0 && arguments.items == 0 && arguments.stride >= kVeryLong)
    return long_row_sum(stream, arguments, error);
  void* pointers[] = {&arguments};
  constexpr int64_t kRows = NOVAPHY_ROW_SUM_CHUNK;
  return launch_function(stream, kernel.function, (n + kRows - 1) / kRows, kRows, pointers,
                         "row_sum_f32", error);
}

novaphy_status scan(novaphy_stream* stream, Function function, uint64_t in, uint64_t out, int64_t n,
                    novaphy_error* error) {
  void* pointers[] = {&in, &out, &n};
  return launch_function(stream, function, 1, 1024, pointers, "exclusive_scan_i32", error);
}

novaphy_status exclusive_scan(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                              const uint64_t* a, novaphy_error* error) {
  return scan(stream, kernel.function, a[0], a[1], n, error);
}

struct SortArguments {
  uint64_t keys, from, to, counts, size;
  int64_t n, limit;
  uint32_t flipped;
  int32_t shift;
};
constexpr int64_t kMaxSortBlocks = 132, kSortBlock = 128, kDigits = 64;
constexpr int32_t kDigitBits = 6;
int64_t sort_blocks(int64_t n) {
  return std::clamp<int64_t>((n + kSortBlock - 1) / kSortBlock, 1, kMaxSortBlocks);
}
uint64_t sort_counts(int64_t n) { return static_cast<uint64_t>(sort_blocks(n) * kDigits); }

// Sorts the indices 0 .. n-1 by the lowest `bits` bits of their keys into `result`. `other` is
// memory of the same size. `size` is the address of the number of items below the limit, or null.
novaphy_status sort(novaphy_stream* stream, const Functions& f, SortArguments arguments,
                    int32_t bits, uint64_t result, uint64_t other, const char* name,
                    novaphy_error* error) {
  const int64_t blocks = sort_blocks(arguments.n);
  // the first pass removes the items above the limit
  const uint64_t size = std::exchange(arguments.size, 0);
  void* pointers[] = {&arguments};
  if ((bits + kDigitBits - 1) / kDigitBits % 2 == 0) std::swap(result, other);
  for (arguments.shift = 0; arguments.shift < bits; arguments.shift += kDigitBits) {
    arguments.to = result;
    for (const Function step : {f.sort_count, f.sort_place}) {
      const novaphy_status status =
          launch_function(stream, step, blocks, kSortBlock, pointers, name, error);
      if (status != NOVAPHY_OK) return status;
    }
    arguments.from = result;
    arguments.size = size;
    std::swap(result, other);
  }
  return NOVAPHY_OK;
}

novaphy_status sort_by_key(novaphy_stream* stream, const novaphy_kernel&, int64_t n,
                           const uint64_t* a, novaphy_error* error) {
  constexpr const char* kName = "sort_by_key_i32";
  Scratch scratch(stream);
  const auto count = static_cast<uint64_t>(n);
  const novaphy_status status = scratch.allocate(count + sort_counts(n), kName, error);
  if (status != NOVAPHY_OK) return status;
  return sort(stream, functions_of(stream->device),
              {.keys = a[0],
               .from = 0,
               .to = 0,
               .counts = scratch.words(count),
               .size = 0,
               .n = n,
               .limit = int64_t{1} << 32,
               .flipped = 0x80000000u,  // negative keys come first
               .shift = 0},
              32, a[1], scratch.words(0), kName, error);
}

novaphy_status incidence(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                         const uint64_t* a, novaphy_error* error) {
  uint64_t table = a[0], offsets = a[2], items = a[3];
  auto slots = static_cast<int64_t>(a[1]);
  if (slots < 0 || slots > std::numeric_limits<int32_t>::max())
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "incidence_i32: slots: expected 0 to 2^31 - 1, got %lld",
                static_cast<long long>(slots));
  const Functions& f = functions_of(stream->device);
  const Driver& d = driver();
  novaphy_status status =
      check(stream->device, d.fill_32(offsets, 0, static_cast<size_t>(n) + 1, stream->stream),
            "incidence_i32", error);
  if (status != NOVAPHY_OK || slots == 0) return status;
  SinkArgument sink = sink_of(stream->device, kernel.number);
  const int64_t blocks = (slots + kBlock - 1) / kBlock;
  void* count_pointers[] = {&table, &slots, &offsets, &n, &sink};
  status = launch_function(stream, f.incidence_count, blocks, kBlock, count_pointers,
                           "incidence_i32", error);
  if (status == NOVAPHY_OK) status = scan(stream, f.scan, offsets, offsets, n + 1, error);
  if (status != NOVAPHY_OK) return status;
  Scratch scratch(stream);
  const auto words = static_cast<uint64_t>(slots);
  status = scratch.allocate(words + sort_counts(slots), "incidence_i32", error);
  if (status != NOVAPHY_OK) return status;
  return sort(stream, f,
              {.keys = table,
               .from = 0,
               .to = 0,
               .counts = scratch.words(words),
               .size = offsets + 4 * static_cast<uint64_t>(n),
               .n = slots,
               .limit = n,
               .flipped = 0,  // as an unsigned number, a negative key is above the limit
               .shift = 0},
              std::max(1, static_cast<int32_t>(std::bit_width(static_cast<uint64_t>(n - 1)))),
              items, scratch.words(0), "incidence_i32", error);
}

novaphy_status checksum(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                        const uint64_t* a, novaphy_error* error) {
  uint64_t data = a[0], out = a[2];
  auto bytes = static_cast<int64_t>(a[1]);
  if (bytes < 1 || n != (bytes - 1) / 8 + 1)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "checksum_u64: bytes: expected 1 to 8 for each of %lld words, got %lld",
                static_cast<long long>(n), static_cast<long long>(bytes));
  const novaphy_status status =
      check(stream->device, driver().fill_32(out, 0, 2, stream->stream), "checksum_u64", error);
  if (status != NOVAPHY_OK) return status;
  constexpr int64_t kThreads = 256, kMaxBlocks = 1024;
  void* pointers[] = {&data, &bytes, &out};
  return launch_function(stream, kernel.function,
                         std::min((n + kThreads - 1) / kThreads, kMaxBlocks), kThreads, pointers,
                         "checksum_u64", error);
}

}  // namespace

void forget_builtins(const novaphy_device* device) {
  const std::lock_guard lock(g_mutex);
  const auto found = g_functions.find(device);
  if (found == g_functions.end()) return;
  if (found->second.module != nullptr && !device->lost)
    driver().module_unload(found->second.module);
  g_functions.erase(found);
}

novaphy_status make_builtin(novaphy_device* device, std::string_view name, novaphy_kernel& kernel,
                            novaphy_error* error) {
  struct Builtin {
    const char* name;
    uint32_t arguments;
    novaphy_status (*run)(novaphy_stream*, const novaphy_kernel&, int64_t, const uint64_t*,
                          novaphy_error*);
    Function Functions::*function;
  };
  static constexpr Builtin kBuiltins[] = {
      {"row_sum_f32", 7, row_sum, &Functions::row_sum},
      {"exclusive_scan_i32", 2, exclusive_scan, &Functions::scan},
      {"sort_by_key_i32", 2, sort_by_key, &Functions::sort_count},
      {"incidence_i32", 4, incidence, &Functions::incidence_count},
      {"checksum_u64", 3, checksum, &Functions::checksum},
  };
  for (const Builtin& builtin : kBuiltins) {
    if (name != builtin.name) continue;
    const Functions* f = nullptr;
    const novaphy_status status = load_functions(device, &f, error);
    if (status != NOVAPHY_OK) return status;
    kernel.function = f->*builtin.function;
    kernel.run = builtin.run;
    kernel.argument_count = builtin.arguments;
    kernel.name = builtin.name;
    kernel.number = remember_kernel(device, {builtin.name, {}});
    return NOVAPHY_OK;
  }
  return fail(error, NOVAPHY_INVALID_ARGUMENT, "unknown builtin '%.*s'",
              static_cast<int>(std::min<size_t>(name.size(), 64)), name.data());
}

}  // namespace novaphy::gpu
