// The builtins of <novaphy/abi/program.h>. The build appends this source to device_prelude.cuh.
#define BUILTIN VENDOR_ENTRY

// Sums the rows of one column from +0, by the row-sum rule of program.h for long rows: chunks of
// kChunk are folded from +0 each, then the chunk sums by the same rule. One block computes the sum.
// Thread 0 has the result.
#define kChunk 256
struct row_sum_arguments {
  const float* source;
  const int32_t* offsets;
  const int32_t* items;
  const float* init;
  float* out;
  int64_t width, stride, n;
};
LANE_FN float fold_items(const row_sum_arguments a, int64_t begin, int64_t end, int64_t column,
                         float sum) {
  if (a.items != 0) {
    for (int64_t k = begin; k < end; ++k) sum += a.source[a.items[k] * a.width + column];
  } else {
    for (int64_t k = begin; k < end; ++k) sum += a.source[k * a.width + column];
  }
  return sum;
}
LANE_FN float fold_shared(const float* values, int32_t count) {
  float sum = 0.0f;
  for (int32_t k = 0; k < count; ++k) sum += values[k];
  return sum;
}
static __device__ float fold_long(const row_sum_arguments a, int64_t begin, int64_t end,
                                  int64_t column, float (*level)[kChunk]) {
  const int64_t chunks = (end - begin + kChunk - 1) / kChunk;
  const int64_t groups = (chunks + kChunk - 1) / kChunk;
  const bool deep = groups > kChunk;
  int32_t seconds = 0, thirds = 0;
  for (int64_t g = 0; g < groups; ++g) {
    const int64_t chunk = g * kChunk + threadIdx.x;
    if (chunk < chunks) {
      const int64_t from = begin + chunk * kChunk;
      const int64_t to = from + kChunk < end ? from + kChunk : end;
      level[0][threadIdx.x] = fold_items(a, from, to, column, 0.0f);
    }
    __syncthreads();
    if (threadIdx.x == 0) {
      const int64_t left = chunks - g * kChunk;
      level[1][seconds++] = fold_shared(level[0], left < kChunk ? (int32_t)left : kChunk);
      if (deep && (seconds == kChunk || g + 1 == groups)) {
        level[2][thirds++] = fold_shared(level[1], seconds);
        seconds = 0;
      }
    }
    __syncthreads();
  }
  if (groups == 1) return level[1][0];
  return deep ? fold_shared(level[2], thirds) : fold_shared(level[1], seconds);
}
BUILTIN __launch_bounds__(kChunk) row_sum_f32(const row_sum_arguments a) {
  __shared__ float level[3][kChunk];
  __shared__ int32_t long_rows[kChunk];
  __shared__ int32_t long_count;
  if (threadIdx.x == 0) long_count = 0;
  __syncthreads();
  const int64_t row = (int64_t)blockIdx.x * kChunk + threadIdx.x;
  if (row < a.n) {
    const int64_t begin = a.offsets != 0 ? a.offsets[row] : row * a.stride;
    const int64_t end = a.offsets != 0 ? a.offsets[row + 1] : begin + a.stride;
    if (end - begin <= kChunk) {
      for (int64_t c = 0; c < a.width; ++c) {
        const float start = a.init != 0 ? a.init[row * a.width + c] : 0.0f;
        a.out[row * a.width + c] = fold_items(a, begin, end, c, start);
      }
    } else {
      long_rows[atomicAdd(&long_count, 1)] = (int32_t)threadIdx.x;  // in any order
    }
  }
  __syncthreads();
  for (int32_t k = 0; k < long_count; ++k) {
    const int64_t r = (int64_t)blockIdx.x * kChunk + long_rows[k];
    const int64_t begin = a.offsets != 0 ? a.offsets[r] : r * a.stride;
    const int64_t end = a.offsets != 0 ? a.offsets[r + 1] : begin + a.stride;
    for (int64_t c = 0; c < a.width; ++c) {
      const float total = fold_long(a, begin, end, c, level);
      if (threadIdx.x == 0) {
        const float start = a.init != 0 ? a.init[r * a.width + c] : 0.0f;
        a.out[r * a.width + c] = start + total;
      }
      __syncthreads();
    }
  }
}

// Sums one very long row. Each thread sums one chunk. The block reads the chunks in tiles. The
// chunk sums are a shorter row, to which the same pass is applied until one thread can fold the
// rest.
#define kSumThreads 128
#define kTile 32
LANE_FN void tile_barrier() {
#if VENDOR_WARP % kTile == 0
  vendor_warp_barrier();
#else
  __syncthreads();
#endif
}
BUILTIN __launch_bounds__(kSumThreads) row_sum_chunks(const float* source, float* sums,
                                                      const int64_t count, const int64_t width) {
  __shared__ float tiles[kSumThreads / kTile][kTile][kTile + 1];
  float(*const tile)[kTile + 1] = tiles[threadIdx.x / kTile];
  const int64_t lane = threadIdx.x % kTile, column = blockIdx.x % width;
  // the first chunk of this warp's tile
  const int64_t first = (blockIdx.x / width * kSumThreads + threadIdx.x) / kTile * kTile;
  float sum = 0.0f;
  for (int64_t t = 0; t < kChunk; t += kTile) {
#pragma unroll 8
    for (int64_t j = 0; j < kTile; ++j) {
      const int64_t k = (first + j) * kChunk + t + lane;
      tile[j][lane] = k < count ? source[k * width + column] : 0.0f;
    }
    tile_barrier();
    const int64_t left = count - (first + lane) * kChunk - t;
    for (int64_t q = 0; q < kTile && q < left; ++q) sum += tile[lane][q];
    tile_barrier();
  }
  if ((first + lane) * kChunk < count) sums[(first + lane) * width + column] = sum;
}
BUILTIN __launch_bounds__(kSumThreads) row_sum_last(const float* sums, const float* init, float* out,
                                                    const int64_t count, const int64_t width) {
  for (int64_t c = threadIdx.x; c < width; c += kSumThreads) {
    float sum = 0.0f;
    for (int64_t k = 0; k < count; ++k) sum += sums[k * width + c];
    out[c] = (init != 0 ? init[c] : 0.0f) + sum;
  }
}

// Exclusive prefix sum by one block. A thread takes kScanItems neighboring items at a time.
// Integers wrap around, so the order of additions does not matter.
#define kScanThreads 1024
#define kScanItems 4
// Returns the sum of the words of the block's threads up to and including this one.
#if VENDOR_WARP > 1
LANE_FN uint32_t warp_sum(uint32_t sum, uint32_t lane) {
  for (int step = 1; step < VENDOR_WARP; step *= 2) {
    const uint32_t other = vendor_shuffle_up(sum, step);
    if (lane >= (uint32_t)step) sum += other;
  }
  return sum;
}
LANE_FN uint32_t block_sum(uint32_t mine) {
  constexpr uint32_t kWarps = kScanThreads / VENDOR_WARP;
  static_assert(kWarps <= VENDOR_WARP, "the first warp adds the sums of all");
  __shared__ uint32_t warps[kWarps];
  const uint32_t lane = threadIdx.x % VENDOR_WARP, warp = threadIdx.x / VENDOR_WARP;
  const uint32_t sum = warp_sum(mine, lane);
  if (lane == VENDOR_WARP - 1) warps[warp] = sum;
  __syncthreads();
  if (warp == 0) {
    const uint32_t all = warp_sum(lane < kWarps ? warps[lane] : 0u, lane);
    if (lane < kWarps) warps[lane] = all;
  }
  __syncthreads();
  return sum + (warp == 0 ? 0u : warps[warp - 1]);
}
#else
LANE_FN uint32_t block_sum(uint32_t mine) {
  __shared__ uint32_t sums[2][kScanThreads];
  uint32_t from = 0;
  sums[from][threadIdx.x] = mine;
  for (uint32_t step = 1; step < kScanThreads; step *= 2, from ^= 1u) {
    __syncthreads();
    const uint32_t other = threadIdx.x >= step ? sums[from][threadIdx.x - step] : 0u;
    sums[from ^ 1u][threadIdx.x] = sums[from][threadIdx.x] + other;
  }
  return sums[from][threadIdx.x];
}
#endif
BUILTIN __launch_bounds__(kScanThreads) exclusive_scan_i32(const uint32_t* in, uint32_t* out,
                                                           const int64_t n) {
  __shared__ uint32_t carry;
  if (threadIdx.x == 0) carry = 0;
  __syncthreads();
  for (int64_t base = 0; base < n; base += kScanThreads * kScanItems) {
    const int64_t first = base + (int64_t)threadIdx.x * kScanItems;
    uint32_t value[kScanItems], mine = 0;
    for (int k = 0; k < kScanItems; ++k) {
      value[k] = first + k < n ? in[first + k] : 0u;
      mine += value[k];
    }
    const uint32_t sum = block_sum(mine);
    uint32_t before = carry + sum - mine;
    for (int k = 0; k < kScanItems; ++k) {
      if (first + k < n) out[first + k] = before;
      before += value[k];
    }
    __syncthreads();
    if (threadIdx.x == kScanThreads - 1) carry += sum;
    __syncthreads();
  }
}

// One pass of a stable radix sort. Every thread counts a contiguous part of the items and later
// places them, in order. counts {blocks, digits} has the counts of each block.
#define kDigits 64
#define kSortThreads 128
struct sort_arguments {
  const int32_t* keys;
  const int32_t* from;  // null: the items are 0, 1, 2, ...
  int32_t* to;
  uint32_t* counts;
  const int32_t* size;  // null: n items
  int64_t n, limit;  // items whose key is not below the limit are removed
  uint32_t flipped;     // bits of the key to flip
  int32_t shift;
};
struct sort_piece {
  int64_t begin, end;
};
LANE_FN sort_piece piece_of(const sort_arguments a) {
  const int64_t n = a.size != 0 ? *a.size : a.n, threads = (int64_t)gridDim.x * kSortThreads;
  const int64_t each = (n + threads - 1) / threads;
  const int64_t begin = each * ((int64_t)blockIdx.x * kSortThreads + threadIdx.x);
  return {begin, begin + each < n ? begin + each : n};
}
// Finds item k and its digit. Returns whether the key is below the limit.
LANE_FN bool sort_item(const sort_arguments a, int64_t k, int32_t* item, uint32_t* digit) {
  *item = a.from != 0 ? a.from[k] : (int32_t)k;
  const uint32_t key = (uint32_t)a.keys[*item] ^ a.flipped;
  *digit = (key >> a.shift) & (kDigits - 1);
  return key < a.limit;
}
LANE_FN void count_digits(const sort_arguments a, uint32_t* count) {
  int32_t item;
  uint32_t digit;
  for (int d = 0; d < kDigits; ++d) count[d] = 0;
  const sort_piece piece = piece_of(a);
  for (int64_t k = piece.begin; k < piece.end; ++k)
    if (sort_item(a, k, &item, &digit)) ++count[digit];
}
BUILTIN __launch_bounds__(kSortThreads) sort_count(const sort_arguments a) {
  __shared__ uint32_t count[kSortThreads][kDigits + 1];
  count_digits(a, count[threadIdx.x]);
  __syncthreads();
  if (threadIdx.x >= kDigits) return;
  uint32_t sum = 0;
  for (int t = 0; t < kSortThreads; ++t) sum += count[t][threadIdx.x];
  a.counts[(int64_t)blockIdx.x * kDigits + threadIdx.x] = sum;
}
BUILTIN __launch_bounds__(kSortThreads) sort_place(const sort_arguments a) {
  __shared__ uint32_t next[kSortThreads][kDigits + 1], all[kDigits];
  const uint32_t d = threadIdx.x;
  uint32_t place = 0, sum = 0;
  count_digits(a, next[threadIdx.x]);
  if (d < kDigits) {
#pragma unroll 8
    for (uint32_t b = 0; b < gridDim.x; ++b) {
      const uint32_t count = a.counts[(int64_t)b * kDigits + d];
      sum += count;
      if (b < blockIdx.x) place += count;
    }
    all[d] = sum;
  }
  __syncthreads();
  if (d < kDigits) {
    for (uint32_t below = 0; below < d; ++below) place += all[below];
    for (int t = 0; t < kSortThreads; ++t) {
      const uint32_t count = next[t][d];
      next[t][d] = place;
      place += count;
    }
  }
  __syncthreads();
  int32_t item;
  uint32_t digit;
  const sort_piece piece = piece_of(a);
  for (int64_t k = piece.begin; k < piece.end; ++k)
    if (sort_item(a, k, &item, &digit)) a.to[next[threadIdx.x][digit]++] = item;
}

// First step of the inverse of an index table: counts how often each row occurs. A scan of the
// counts gives the offsets. A sort of the slots by row gives the slots of every row.
BUILTIN __launch_bounds__(128) incidence_count(const int32_t* table, const int64_t slots,
                                               int32_t* offsets, const int64_t n,
                                               const device_sink sink) {
  const int64_t s = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;
  if (s >= slots) return;
  const int32_t row = table[s];
  if (row >= n) {
    report_row(sink, s, -1, row, n);
  } else if (row >= 0) {
    atomicAdd(offsets + row, 1);
  }
}

// The hash includes the position of each word, so a swap of two words changes the checksum. The
// sums of blocks are added in any order, because integers wrap around. `out` is zero before.
#define kChecksumThreads 256
LANE_FN uint64_t checksum_mix(uint64_t x) {
  x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93ull;
  return x ^ (x >> 32);
}
LANE_FN uint64_t checksum_word(const unsigned char* data, const int64_t bytes, const int64_t k) {
  if (bytes - 8 * k >= 8) {
    if (((uint64_t)data & 7) == 0) return ((const uint64_t*)data)[k];
    if (((uint64_t)data & 3) == 0)
      return ((const uint32_t*)data)[2 * k] | (uint64_t)((const uint32_t*)data)[2 * k + 1] << 32;
  }
  uint64_t word = 0;
  for (int64_t b = 8 * k; b < bytes && b < 8 * k + 8; ++b)
    word |= (uint64_t)data[b] << (8 * (b - 8 * k));
  return word;
}
BUILTIN __launch_bounds__(kChecksumThreads) checksum_u64(const unsigned char* data,
                                                         const int64_t bytes,
                                                         unsigned long long* out) {
  __shared__ uint64_t sums[kChecksumThreads];
  const int64_t words = (bytes + 7) / 8;
  uint64_t sum = 0;
  for (int64_t k = (int64_t)blockIdx.x * kChecksumThreads + threadIdx.x; k < words;
       k += (int64_t)gridDim.x * kChecksumThreads)
    sum += checksum_mix(
        checksum_mix(checksum_word(data, bytes, k) + (uint64_t)k * 0x9E3779B97F4A7C15ull));
  sums[threadIdx.x] = sum;
  __syncthreads();
  for (unsigned step = kChecksumThreads / 2; step != 0; step /= 2) {
    if (threadIdx.x < step) sums[threadIdx.x] += sums[threadIdx.x + step];
    __syncthreads();
  }
  if (threadIdx.x == 0) atomicAdd(out, (unsigned long long)sums[0]);
}
