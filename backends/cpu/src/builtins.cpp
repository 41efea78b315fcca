// The builtins of the CPU: ordered row sums, scan, stable sort, the inverse of an index table, and
// the checksum.
#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "module.h"
#include "novaphy/abi/program.h"
#include "novaphy/cpu/float_mode.h"

namespace novaphy::cpu {
namespace {

template <class T>
T* pointer(uint64_t word) {
  return reinterpret_cast<T*>(word);
}

constexpr int64_t kSumChunk = NOVAPHY_ROW_SUM_CHUNK;
constexpr int64_t kMaxRowsPerChunk = 256, kItemsPerChunk = 1024;

struct RowSum {
  const float* source;
  const int32_t* offsets;
  const int32_t* items;
  const float* init;
  float* out;
  int64_t width, stride, n;

  int64_t begin(int64_t row) const { return offsets != nullptr ? offsets[row] : row * stride; }
  int64_t end(int64_t row) const {
    return offsets != nullptr ? offsets[row + 1] : (row + 1) * stride;
  }
  int64_t number(int64_t k) const { return items != nullptr ? items[k] : k; }
  const float* item(int64_t k) const { return source + number(k) * width; }
};

// Adds the items [begin, end) to acc[0..width), in order. The constant width keeps the sums in
// machine registers.
template <int kWidth>
void fold(const RowSum& s, int64_t begin, int64_t end, float* acc) {
  float sum[kWidth];
  for (int c = 0; c < kWidth; ++c) sum[c] = acc[c];
  for (int64_t k = begin; k < end; ++k) {
    const float* item = s.item(k);
    for (int c = 0; c < kWidth; ++c) sum[c] += item[c];
  }
  for (int c = 0; c < kWidth; ++c) acc[c] = sum[c];
}

void fold_any(const RowSum& s, int64_t begin, int64_t end, float* acc) {
  switch (s.width) {
    case 1:
      return fold<1>(s, begin, end, acc);
    case 2:
      return fold<2>(s, begin, end, acc);
    case 3:
      return fold<3>(s, begin, end, acc);
    case 4:
      return fold<4>(s, begin, end, acc);
    case 6:
      return fold<6>(s, begin, end, acc);
    case 7:
      return fold<7>(s, begin, end, acc);
    case 9:
      return fold<9>(s, begin, end, acc);
    default:
      break;
  }
  for (int64_t k = begin; k < end; ++k) {
    const float* item = s.item(k);
    for (int64_t c = 0; c < s.width; ++c) acc[c] += item[c];
  }
}

// Sums contiguous rows of `width` floats from +0, by the row-sum rule for long rows (program.h).
// Overwrites the rows with the sums of chunks.
void fold_chunks(float* sums, int64_t count, int64_t width, float* result) {
  const auto fold_rows = [&](int64_t begin, int64_t end) {
    std::fill(result, result + width, 0.0f);
    for (int64_t k = begin; k < end; ++k) {
      for (int64_t c = 0; c < width; ++c) result[c] += sums[k * width + c];
    }
  };
  while (count > kSumChunk) {
    const int64_t chunks = (count + kSumChunk - 1) / kSumChunk;
    for (int64_t chunk = 0; chunk < chunks; ++chunk) {
      const int64_t begin = chunk * kSumChunk;
      fold_rows(begin, std::min(count, begin + kSumChunk));
      std::copy(result, result + width, sums + chunk * width);
    }
    count = chunks;
  }
  fold_rows(0, count);
}

// Memory for the partial sums of a long row. Each thread keeps its memory, so that a replay
// allocates none. A sum moves the vector out of the thread variable, because the thread may start
// another row while it waits.
thread_local std::vector<float> t_partial;

struct LongRow {
  const RowSum* sum;
  int64_t begin, end;
  float* partial;
};

void sum_one_chunk(void* opaque, int64_t chunk) {
  const LongRow& row = *static_cast<const LongRow*>(opaque);
  const FloatMode mode;
  float* acc = row.partial + chunk * row.sum->width;
  const int64_t begin = row.begin + chunk * kSumChunk;
  fold_any(*row.sum, begin, std::min(row.end, begin + kSumChunk), acc);
}

void sum_long_row(const novaphy_host_api& host, const RowSum& s, int64_t begin, int64_t end,
                  float* acc) {
  const int64_t chunks = (end - begin + kSumChunk - 1) / kSumChunk;
  std::vector<float> partial = std::move(t_partial);
  partial.assign(static_cast<size_t>((chunks + 1) * s.width), 0.0f);  // plus one row for the total
  LongRow row{&s, begin, end, partial.data()};
  if (chunks >= 8) {
    host.parallel_for(chunks, sum_one_chunk, &row);  // serial if the rows already run in parallel
  } else {
    for (int64_t chunk = 0; chunk < chunks; ++chunk) sum_one_chunk(&row, chunk);
  }
  float* total = partial.data() + chunks * s.width;
  fold_chunks(partial.data(), chunks, s.width, total);
  for (int64_t c = 0; c < s.width; ++c) acc[c] += total[c];
  t_partial = std::move(partial);
}

struct RowSumLaunch {
  RowSum sum, second;  // second.out null: no second sum
  ThreeSums threes;    // the same for a width of 3
  int64_t chunk_rows;
  const novaphy_host_api* host;
  const IsaTable* isa;
  std::atomic<bool> out_of_memory{false};
};

void sum_row(RowSumLaunch& launch, const RowSum& s, int64_t row) {
  float* out = s.out + row * s.width;
  if (s.init == nullptr) {
    std::fill(out, out + s.width, 0.0f);
  } else if (s.init != s.out) {
    std::memcpy(out, s.init + row * s.width, static_cast<size_t>(s.width) * sizeof(float));
  }
  const int64_t begin = s.begin(row), end = s.end(row);
  if (end - begin <= kSumChunk) return fold_any(s, begin, end, out);
  try {
    sum_long_row(*launch.host, s, begin, end, out);
  } catch (...) {  // only the partial sums allocate memory
    launch.out_of_memory = true;
  }
}

void sum_rows(void* opaque, int64_t chunk) {
  auto& launch = *static_cast<RowSumLaunch*>(opaque);
  const FloatMode mode;
  const int64_t first = chunk * launch.chunk_rows,
                last = std::min(launch.sum.n, first + launch.chunk_rows);
  for (int64_t row = first; row < last; ++row) {
    if (launch.sum.width == 3) row = launch.isa->sum_threes(launch.threes, row, last);
    if (row == last) return;
    sum_row(launch, launch.sum, row);
    if (launch.second.out != nullptr) sum_row(launch, launch.second, row);
  }
}

novaphy_status row_sums(const novaphy_host_api& host, const IsaTable& isa, int64_t n,
                        const uint64_t* a, bool pair, novaphy_error* error) {
  RowSumLaunch launch;
  launch.host = &host;
  launch.isa = &isa;
  launch.sum = {pointer<const float>(a[0]),   pointer<const int32_t>(a[1]),
                pointer<const int32_t>(a[2]), pointer<const float>(a[3]),
                pointer<float>(a[4]),         static_cast<int64_t>(a[5]),
                static_cast<int64_t>(a[6]),   n};
  launch.second = launch.sum;
  launch.second.source = pair ? pointer<const float>(a[7]) : nullptr;
  launch.second.init = pair ? pointer<const float>(a[8]) : nullptr;
  launch.second.out = pair ? pointer<float>(a[9]) : nullptr;
  const auto three = [](const RowSum& s) { return ThreeSum{s.source, s.init, s.out}; };
  launch.threes = {{three(launch.sum), three(launch.second)},
                   launch.sum.offsets,
                   launch.sum.items,
                   launch.sum.stride,
                   kSumChunk};
  if (launch.sum.width < 1) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "row_sum_f32: width: expected at least 1, got %lld",
                static_cast<long long>(launch.sum.width));
  }
  if (launch.sum.offsets == nullptr && launch.sum.stride < 0) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "row_sum_f32: stride: expected at least 0, got %lld",
                static_cast<long long>(launch.sum.stride));
  }
  const int64_t items = launch.sum.end(n - 1) - launch.sum.begin(0);
  const int64_t most =
      std::clamp<int64_t>(n * kItemsPerChunk / std::max<int64_t>(1, items), 1, kMaxRowsPerChunk);
  const int64_t chunks = (n + most - 1) / most;
  launch.chunk_rows = (n + chunks - 1) / chunks;
  if (chunks == 1) {
    sum_rows(&launch, 0);
  } else {
    host.parallel_for(chunks, sum_rows, &launch);
  }
  if (launch.out_of_memory)
    return fail(error, NOVAPHY_OUT_OF_MEMORY, "row_sum_f32: out of host memory");
  return NOVAPHY_OK;
}
novaphy_status row_sum(const novaphy_host_api& host, const IsaTable& isa, int64_t n,
                       const uint64_t* a, novaphy_error* error) {
  return row_sums(host, isa, n, a, false, error);
}
novaphy_status row_sum_pair(const novaphy_host_api& host, const IsaTable& isa, int64_t n,
                            const uint64_t* a, novaphy_error* error) {
  return row_sums(host, isa, n, a, true, error);
}

novaphy_status exclusive_scan(const novaphy_host_api&, const IsaTable&, int64_t n,
                              const uint64_t* a, novaphy_error*) {
  const auto* in = pointer<const uint32_t>(a[0]);
  auto* out = pointer<uint32_t>(a[1]);
  uint32_t sum = 0;  // i32 arithmetic wraps
  for (int64_t k = 0; k < n; ++k) {
    const uint32_t value = in[k];
    out[k] = sum;
    sum += value;
  }
  return NOVAPHY_OK;
}

// A radix sort from the least significant digit, 11 bits at a time. Each pass is stable.
novaphy_status sort_by_key(const novaphy_host_api&, const IsaTable&, int64_t n, const uint64_t* a,
                           novaphy_error*) {
  const auto* keys = pointer<const int32_t>(a[0]);
  auto* order = pointer<int32_t>(a[1]);
  if (n <= 64) {
    std::iota(order, order + n, 0);
    for (int64_t k = 1; k < n; ++k) {  // insertion sort is stable
      const int32_t item = order[k];
      int64_t at = k;
      for (; at > 0 && keys[order[at - 1]] > keys[item]; --at) order[at] = order[at - 1];
      order[at] = item;
    }
    return NOVAPHY_OK;
  }
  constexpr uint32_t kBits = 11, kBuckets = 1u << kBits;
  const auto digit = [&](int32_t item, uint32_t shift) {
    return ((static_cast<uint32_t>(keys[item]) ^ 0x80000000u) >> shift) & (kBuckets - 1);
  };
  std::vector<int32_t> from(static_cast<size_t>(n)), to(static_cast<size_t>(n));
  std::iota(from.begin(), from.end(), 0);
  std::vector<int64_t> next(kBuckets + 1);
  for (uint32_t shift = 0; shift < 32; shift += kBits) {
    std::fill(next.begin(), next.end(), 0);
    for (const int32_t item : from) ++next[digit(item, shift) + 1];
    std::partial_sum(next.begin(), next.end(), next.begin());
    for (const int32_t item : from) to[static_cast<size_t>(next[digit(item, shift)]++)] = item;
    from.swap(to);
  }
  std::copy(from.begin(), from.end(), order);
  return NOVAPHY_OK;
}

novaphy_status incidence(const novaphy_host_api&, const IsaTable&, int64_t n, const uint64_t* a,
                         novaphy_error* error) {
  const auto* table = pointer<const int32_t>(a[0]);
  const auto slots = static_cast<int64_t>(a[1]);
  auto* offsets = pointer<int32_t>(a[2]);
  auto* items = pointer<int32_t>(a[3]);
  if (slots < 0 || slots > std::numeric_limits<int32_t>::max()) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "incidence_i32: slots: expected 0 to 2^31 - 1, got %lld",
                static_cast<long long>(slots));
  }
  for (int64_t s = 0; s < slots; ++s) {  // checked before any result is written
    if (table[s] >= n) {
      return fail(error, NOVAPHY_INDEX_OUT_OF_RANGE,
                  "incidence_i32: slot %lld holds row %d of %lld rows", static_cast<long long>(s),
                  table[s], static_cast<long long>(n));
    }
  }
  std::fill(offsets, offsets + n + 1, 0);
  for (int64_t s = 0; s < slots; ++s) {
    if (table[s] >= 0) ++offsets[table[s] + 1];
  }
  std::partial_sum(offsets, offsets + n + 1, offsets);
  // This loop advances each offset to the end of its row. The code below shifts the offsets back.
  for (int64_t s = 0; s < slots; ++s) {
    if (table[s] >= 0) items[offsets[table[s]]++] = static_cast<int32_t>(s);
  }
  std::copy_backward(offsets, offsets + n, offsets + n + 1);
  offsets[0] = 0;
  return NOVAPHY_OK;
}

struct Checksum {
  const unsigned char* data;
  int64_t bytes;
  std::atomic<uint64_t> sum{0};  // the order of threads does not matter, because the sum wraps
};
constexpr int64_t kChecksumChunk = 8192;  // words

uint64_t mix(uint64_t x) {
  x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93ull;
  return x ^ (x >> 32);
}

void checksum_chunk(void* opaque, int64_t chunk) {
  auto& c = *static_cast<Checksum*>(opaque);
  const int64_t words = (c.bytes + 7) / 8, first = chunk * kChecksumChunk,
                last = std::min(words, first + kChecksumChunk);
  uint64_t sum = 0;
  const auto add = [&](int64_t k, size_t bytes) {
    uint64_t word = 0;
    std::memcpy(&word, c.data + 8 * k, bytes);
    sum += mix(mix(word + static_cast<uint64_t>(k) * 0x9E3779B97F4A7C15ull));
  };
  const int64_t whole = std::min(last, c.bytes / 8);
  for (int64_t k = first; k < whole; ++k) add(k, 8);
  if (whole < last) add(whole, static_cast<size_t>(c.bytes % 8));
  c.sum.fetch_add(sum, std::memory_order_relaxed);
}

novaphy_status checksum(const novaphy_host_api& host, const IsaTable&, int64_t n, const uint64_t* a,
                        novaphy_error* error) {
  const auto bytes = static_cast<int64_t>(a[1]);
  if (bytes < 1 || n != (bytes - 1) / 8 + 1) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "checksum_u64: bytes: expected 1 to 8 for each of %lld words, got %lld",
                static_cast<long long>(n), static_cast<long long>(bytes));
  }
  Checksum launch{pointer<const unsigned char>(a[0]), bytes};
  host.parallel_for((n + kChecksumChunk - 1) / kChecksumChunk, checksum_chunk, &launch);
  *pointer<uint64_t>(a[2]) = launch.sum;
  return NOVAPHY_OK;
}

constexpr Builtin kBuiltins[] = {
    {"row_sum_f32", 7, row_sum},
    {"row_sum_pair_f32", 10, row_sum_pair},
    {"exclusive_scan_i32", 2, exclusive_scan},
    {"sort_by_key_i32", 2, sort_by_key},
    {"incidence_i32", 4, incidence},
    {"checksum_u64", 3, checksum},
};

}  // namespace

const Builtin* find_builtin(std::string_view name) {
  for (const Builtin& builtin : kBuiltins) {
    if (name == builtin.name) return &builtin;
  }
  return nullptr;
}

}  // namespace novaphy::cpu
