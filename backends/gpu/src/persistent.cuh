// A persistent kernel: phases as one launch, with a barrier after each phase. A chain is a sequence
// of operations on the same rows. Chains with the same code have the same form. device_prelude.cuh
// comes before this file, the Programs and run_chain after it. A table has a record for each phase:
//   words of the next record << 32 | its first word   warps << 32 | rows of a warp << 16 | chains
//   per chain: its first warp << 32 | rows       form << 32 | the first word of its arguments
//   the arguments; before those of a Program, the number of the kernel
// A warp computes rows of one chain. Records are loaded two phases ahead. If no warp has two chains
// of a phase, the table also has the task of each warp, so that no search follows a barrier:
//   form << 48 | the first word of the arguments << 32 | rows << 24 | the first row
#define kWordsPerThread ((PERSISTENT_WORDS + PERSISTENT_THREADS - 1) / PERSISTENT_THREADS)

LANE_FN uint32_t low_half(uint64_t word) { return (uint32_t)word; }
LANE_FN uint32_t high_half(uint64_t word) { return (uint32_t)(word >> 32); }

template <class S, class O>
LANE_FN void copy_word(const S from, const O to, int64_t row) {
  row_failure failure;
  failure.zeros = 0;
  put_columni(to, 1, 0, row, own_columni(from, 1, 0, 1, 0, row, failure));
}

struct no_source {};  // a source that is not read

// The memory of a block for the items that its sums add in the next phase (see cluster/blocks.h).
// From `base` on there are rows of four words, PERSISTENT_CORNERS for each thread, and a row of
// zeros for sums of few items. Rows of the halo and the threads' kept values follow all arrays.
//
// A register holds the address of this memory. In a cluster, compilers would otherwise read the
// number of the block for each address, which takes dozens of cycles. `turn` is the last turn
// (exchange) of the halo.
struct block_memory {
  four_words* rows;
  uint32_t turn;
};
#if PERSISTENT_LAYOUTS != 0
extern __shared__ four_words g_items[];
constexpr uint32_t kNoItem = PERSISTENT_CORNERS * PERSISTENT_THREADS;
// The row for missing items has -0 in all columns. Adding -0 changes no number, not even -0.
LANE_FN void begin_items() {
  constexpr int32_t kMinusZero = INT32_MIN;
  for (uint32_t base = 0; base < PERSISTENT_ITEMS; base += kNoItem + 1)
    g_items[base + kNoItem] = {{kMinusZero, kMinusZero, kMinusZero, kMinusZero}};
}
template <int width, int count>
LANE_FN void put_items(const block_memory memory, uint32_t base, const int32_t* words) {
  four_words* const rows = memory.rows + base + threadIdx.x * PERSISTENT_CORNERS;
#pragma unroll
  for (int k = 0; k < count; ++k) {
    four_words row;
#pragma unroll
    for (int c = 0; c < 4; ++c) row.word[c] = c < width ? words[k * width + c] : 0;
    rows[k] = row;
  }
}
#endif
struct block_items {
  const four_words* rows;
};
struct memory_items {
  uint64_t source;
};

// The initial value of a row of the builtin row_sum_f32, if there is none.
struct no_init {};
LANE_FN float init_of(const no_init, int32_t, int32_t, int64_t) { return 0.0f; }
template <class S>
LANE_FN float init_of(const S s, int32_t width, int32_t column, int64_t row) {
  row_failure failure;
  failure.zeros = 0;
  return own_columnf(s, width, column, 1, 0, row, failure);
}
// Adds the items [begin, end) to `sum`, in batches. The last batch may reach past the end.
template <int width>
LANE_FN void fold_items(const float* source, const int32_t* items, int64_t begin, int64_t end,
                        float* sum) {
  for (int64_t base = begin; base < end; base += CSR_BATCH) {
#pragma unroll
    for (int64_t k = base; k < base + CSR_BATCH; ++k) {
      const bool on = k < end;
      const int64_t at = on ? k : end - 1;
      const int64_t slot = items != 0 ? (int64_t)__ldg(items + at) : at;
      const float* const row = in_memory(source + slot * width);
#pragma unroll
      for (int c = 0; c < width; ++c) sum[c] = on ? sum[c] + row[c] : sum[c];
    }
  }
}
// The row-sum rule for long rows: sums of chunks of kChunk from +0, then their sum by this rule.
#define kChunk 256
template <int width>
static __device__ __noinline__ void fold_long(const float* source, const int32_t* items,
                                              int64_t begin, int64_t end, float* total) {
  const int64_t chunks = (end - begin + kChunk - 1) / kChunk;
  const bool deep = chunks > (int64_t)kChunk * kChunk;
  for (int c = 0; c < width; ++c) total[c] = 0.0f;
  float second[width] = {}, third[width] = {};
  for (int64_t chunk = 0; chunk < chunks; ++chunk) {
    const int64_t from = begin + chunk * kChunk;
    float first[width] = {};
    fold_items<width>(source, items, from, from + kChunk < end ? from + kChunk : end, first);
    const bool last = chunk + 1 == chunks;
    const bool full = last || (chunk + 1) % kChunk == 0;
    const bool all_full = last || (chunk + 1) % (kChunk * kChunk) == 0;
    for (int c = 0; c < width; ++c) {
      second[c] += first[c];
      if (!full) continue;
      (deep ? third : total)[c] += second[c];
      second[c] = 0.0f;
      if (!deep || !all_full) continue;
      total[c] += third[c];
      third[c] = 0.0f;
    }
  }
}
// Rows of a batch of items, loaded together. Loads are unconditional: a condition for the items
// that short rows lack would make compilers run out of registers.
template <int width, int count = CSR_BATCH>
struct batch_rows {
  float columns[count][width];
};
template <int width, int count>
LANE_FN void load_rows(batch_rows<width, count>* rows, const memory_items from,
                       const csr_batch& csr) {
  const float* const source = (const float*)from.source;
#pragma unroll
  for (int32_t r = 0; r < count; ++r)
#pragma unroll
    for (int c = 0; c < width; ++c)
      rows->columns[r][c] = *in_memory(source + (int64_t)csr.slots[r] * width + c);
}
// Loads the rows of the first batch. If the batch is empty, zeros are loaded, without a branch.
template <int width, int count>
LANE_FN void load_first_rows(batch_rows<width, count>* rows, const memory_items from,
                             const csr_batch& csr, const row_failure& failure) {
  load_rows(rows, memory_items{csr.longest > 0 ? from.source : (uint64_t)failure.zeros}, csr);
}
#if PERSISTENT_LAYOUTS != 0
template <int width, int count>
LANE_FN void load_rows(batch_rows<width, count>* rows, const block_items from,
                       const csr_batch& csr) {
#pragma unroll
  for (int32_t r = 0; r < count; ++r) {
    const four_words row = from.rows[csr.slots[r]];
#pragma unroll
    for (int c = 0; c < width; ++c) rows->columns[r][c] = ubits_f(row.word[c]);
  }
}
template <int width, int count>
LANE_FN void load_first_rows(batch_rows<width, count>* rows, const block_items from,
                             const csr_batch& csr, const row_failure&) {
  load_rows(rows, from, csr);
}
LANE_FN void csr_load_items(csr_batch* c, const int32_t* items) {
  csr_load(c, items, 0);
#pragma unroll
  for (int32_t r = 0; r < CSR_BATCH; ++r) c->slots[r] = csr_on(c, r) ? c->slots[r] : kNoItem;
}
#endif
// Computes one sum per source over the same items. All rows of a batch are loaded before the first
// row is added. `loaded`: the rows of the first batch are already loaded. `chunks`: use the rule
// for long rows.
template <bool loaded, bool chunks, int width, int count, int sums>
LANE_FN void fold_batches(const memory_items* sources, const int32_t* items, csr_batch csr,
                          batch_rows<width, count>* rows, float (*sum)[width]) {
  if (chunks && csr.longest > kChunk) {
#pragma unroll
    for (int s = 0; s < sums; ++s) {
      float total[width];
      fold_long<width>((const float*)sources[s].source, items, csr.start,
                       (int64_t)csr.start + csr.longest, total);
#pragma unroll
      for (int c = 0; c < width; ++c) sum[s][c] += total[c];
    }
    return;
  }
  for (int32_t base = 0; base < csr.longest; base += CSR_BATCH) {
    if (base > 0) csr_load(&csr, items, base);
    if (base > 0 || !loaded) {
#pragma unroll
      for (int s = 0; s < sums; ++s) load_rows(&rows[s], sources[s], csr);
    }
#pragma unroll
    for (int32_t r = 0; r < CSR_BATCH; ++r)
#pragma unroll
      for (int s = 0; s < sums; ++s)
#pragma unroll
        for (int c = 0; c < width; ++c)
          sum[s][c] = csr_on(&csr, base + r) ? sum[s][c] + rows[s].columns[r][c] : sum[s][c];
  }
}
#if PERSISTENT_LAYOUTS != 0
// If `count` is less than a batch, no row has more items than `count`. Otherwise a few rows may
// have more items than a batch, which are added one by one, to keep the code small.
template <bool loaded, bool chunks, int width, int count, int sums>
LANE_FN void fold_batches(const block_items* sources, const int32_t* items, const csr_batch& csr,
                          batch_rows<width, count>* rows, float (*sum)[width]) {
  if (!loaded) {
#pragma unroll
    for (int s = 0; s < sums; ++s) load_rows(&rows[s], sources[s], csr);
  }
#pragma unroll
  for (int32_t r = 0; r < count; ++r)
#pragma unroll
    for (int s = 0; s < sums; ++s)
#pragma unroll
      for (int c = 0; c < width; ++c) sum[s][c] += rows[s].columns[r][c];
  if (count < CSR_BATCH) return;
#pragma unroll 1
  for (int32_t k = CSR_BATCH; k < csr.longest; ++k) {
    const uint32_t slot = __ldg(items + csr.start + k);
#pragma unroll
    for (int s = 0; s < sums; ++s) {
      const four_words row = sources[s].rows[slot];
#pragma unroll
      for (int c = 0; c < width; ++c) sum[s][c] += ubits_f(row.word[c]);
    }
  }
}
#endif
template <bool loaded, bool chunks, int width, int count, class M, class S, class O, class T,
          class P>
LANE_FN void sum_two_rows(const csr_batch& csr, uint64_t items, batch_rows<width, count>* rows,
                          const M v, const S v_init, const O v_out, const M w, const T w_init,
                          const P w_out, int64_t row) {
  const M sources[2] = {v, w};
  float sum[2][width];
#pragma unroll
  for (int c = 0; c < width; ++c) {
    sum[0][c] = init_of(v_init, width, c, row);
    sum[1][c] = init_of(w_init, width, c, row);
  }
  fold_batches<loaded, chunks, width, count, 2>(sources, (const int32_t*)items, csr, rows, sum);
#pragma unroll
  for (int c = 0; c < width; ++c) {
    put_columnf(v_out, width, c, row, sum[0][c]);
    put_columnf(w_out, width, c, row, sum[1][c]);
  }
}
template <bool loaded, bool chunks, int width, int count, class M, class S, class O>
LANE_FN void sum_row(const csr_batch& csr, uint64_t items, batch_rows<width, count>* rows,
                     const M source, const S init, const O out, int64_t row) {
  const M sources[1] = {source};
  float sum[1][width];
#pragma unroll
  for (int c = 0; c < width; ++c) sum[0][c] = init_of(init, width, c, row);
  fold_batches<loaded, chunks, width, count, 1>(sources, (const int32_t*)items, csr, rows, sum);
#pragma unroll
  for (int c = 0; c < width; ++c) put_columnf(out, width, c, row, sum[0][c]);
}
// Sums rows without offsets: all rows have equally many items.
template <int width, class S, class O>
LANE_FN void sum_even_row(const uint64_t* w, const S init, const O out, int64_t row) {
  const float* const source = (const float*)w[0];
  const int32_t* const items = (const int32_t*)w[2];
  const int64_t begin = row * (int64_t)w[6], end = begin + (int64_t)w[6];
  float sum[width];
#pragma unroll
  for (int c = 0; c < width; ++c) sum[c] = init_of(init, width, c, row);
  if (end - begin <= kChunk) {
    fold_items<width>(source, items, begin, end, sum);
  } else {
    float total[width];
    fold_long<width>(source, items, begin, end, total);
#pragma unroll
    for (int c = 0; c < width; ++c) sum[c] += total[c];
  }
#pragma unroll
  for (int c = 0; c < width; ++c) put_columnf(out, width, c, row, sum[c]);
}

// The arguments of an operation, with the CSR tables of its loops that the chain has loaded.
template <int loops>
struct words_and_tables {
  const uint64_t* words;
  const csr_batch* tables[loops];
  __device__ __forceinline__ uint64_t operator[](int32_t k) const { return words[k]; }
};
template <int loops>
LANE_FN csr_batch csr_first(const words_and_tables<loops> args, int32_t, int32_t loop, int64_t) {
  return *args.tables[loop];
}
// The values that a thread keeps in shared memory until its chain runs again.
#if PERSISTENT_KEPT != 0
#if PERSISTENT_LAYOUTS != 0
#define g_kept ((int32_t*)(memory.rows + PERSISTENT_ITEMS + 2 * PERSISTENT_HALO))
#else
__shared__ int32_t g_kept[PERSISTENT_KEPT * PERSISTENT_THREADS];
#endif
LANE_FN bool is_kept(uint32_t kept) { return kept != 0 && (kept & 1) == 0; }
LANE_FN bool is_to_be_filled(uint32_t kept) { return (kept & 1) != 0; }
LANE_FN int32_t* begin_kept(const block_memory memory, uint32_t kept) {
  return g_kept + (kept / 2 - 1) * PERSISTENT_THREADS + threadIdx.x;
}
LANE_FN void fill_kept(int32_t*& at, int32_t word) {
  *at = word;
  at += PERSISTENT_THREADS;
}
LANE_FN void take_kept(int32_t*& at, int32_t& word) {
  word = *at;
  at += PERSISTENT_THREADS;
}
#else
LANE_FN bool is_kept(uint32_t) { return false; }
LANE_FN int32_t* begin_kept(const block_memory, uint32_t) { return 0; }
LANE_FN void fill_kept(int32_t*&, int32_t) {}
LANE_FN void take_kept(int32_t*&, int32_t&) {}
#endif
template <int count>
LANE_FN void fill_kept(int32_t*& at, const int32_t (&words)[count]) {
#pragma unroll
  for (int c = 0; c < count; ++c) fill_kept(at, words[c]);
}
template <int count>
LANE_FN void take_kept(int32_t*& at, int32_t (&words)[count]) {
#pragma unroll
  for (int c = 0; c < count; ++c) take_kept(at, words[c]);
}
// Loads the own rows of a chain before they are needed.
template <int width, bool aligned>
LANE_FN void own_words(uint64_t p, int64_t i, int32_t* words) {
  const int32_t* const row = in_memory((const int32_t*)p + i * width);
#pragma unroll
  for (int c = 0; c < width; c += aligned ? 4 : 1) {
    if (aligned) {
      const four_words four = *(const four_words*)(row + c);
#pragma unroll
      for (int k = 0; k < 4; ++k) words[c + k] = four.word[k];
    } else {
      words[c] = row[c];
    }
  }
}

// With a plan of the row of each thread, no search for chains is needed. The header of a record
// then has the address and size of the early results two phases later, which all blocks prefetch.
constexpr uint32_t kHeader = 4;
#if PERSISTENT_EARLY != 0 && PERSISTENT_HALO != 0
LANE_FN void fetch_early(const uint64_t* record) {
  const uint64_t part = (record[3] / gridDim.x + 15) / 16 * 16, first = part * blockIdx.x;
  if (first >= record[3]) return;
  const uint64_t rest = record[3] - first;
  vendor_prefetch_bytes(record[2] + first, (uint32_t)(rest < part ? rest : part));
}
#endif
// The memory layout of the results of an early half: the first four words of all threads, block
// after block, then the next four words. A warp then loads whole cache lines for any rows.
template <int width>
LANE_FN void store_early(uint64_t p, uint64_t slots, uint32_t slot, const int32_t* words) {
  four_words* at = in_memory((four_words*)p + slot);
#pragma unroll
  for (int c = 0; c < width; c += 4, at += (uint32_t)slots)
    *at = {{words[c], words[c + 1], words[c + 2], words[c + 3]}};
}
// `slots` is: first thread of the chain in a block << 48 | threads of a block << 32 | all threads
LANE_FN uint32_t own_slot(uint64_t slots) {
  return blockIdx.x * (high_half(slots) & 0xffff) + threadIdx.x - (high_half(slots) >> 16);
}
template <int width>
LANE_FN void load_early(uint64_t p, uint64_t slots, uint32_t slot, int32_t* words) {
  const four_words* at = in_memory((const four_words*)p + slot);
#pragma unroll
  for (int c = 0; c < width; c += 4, at += (uint32_t)slots) {
    const four_words four = *at;
#pragma unroll
    for (int k = 0; k < 4; ++k) words[c + k] = four.word[k];
  }
}

// A barrier in two parts. When a thread arrives, it has finished its phase. When its wait ends, the
// thread sees all writes that threads of all blocks made before they arrived. Between the two parts
// a thread may do work that does not depend on these writes. `wrote`: the warp wrote to memory,
// which needs a fence of hundreds of cycles. `count`: the number of earlier barriers.
#if PERSISTENT_FORM == 0  // one block
LANE_FN void phase_arrive(bool) {}
LANE_FN void phase_wait(uint32_t* = 0, uint32_t = 0) {
  vendor_block_barrier();
}
LANE_FN void last_barrier(uint32_t*) {}
#elif PERSISTENT_FORM == 1  // one cluster
LANE_FN void phase_arrive(bool wrote) { vendor_cluster_arrive(wrote); }
LANE_FN void phase_wait(uint32_t* = 0, uint32_t = 0) { vendor_cluster_wait(); }
LANE_FN void last_barrier(uint32_t*) {}
#else  // all blocks; the launch ensures that they run at the same time
LANE_FN void phase_arrive(bool) {}
LANE_FN void phase_wait(uint32_t* counter, uint32_t count) {
  __syncthreads();
  if (threadIdx.x == 0) vendor_grid_barrier(counter, gridDim.x * (count + 1));
  __syncthreads();
}
// The last block to leave resets the counters for the next launch.
LANE_FN void last_barrier(uint32_t* counter) {
  __syncthreads();
  if (threadIdx.x != 0 || atomicAdd(counter + 1, 1u) != gridDim.x - 1) return;
  counter[0] = 0;
  counter[1] = 0;
}
#endif

// For sums of items that the same block made in the previous phase. The warps that make the items
// hand them over to the warps that add them. The adding warps wait only for this handover, and for
// the other blocks before they store.
#if PERSISTENT_LAYOUTS != 0
// The handover also orders earlier stores, as a barrier does.
LANE_FN void hand_over() { vendor_hand_over<PERSISTENT_THREADS>(); }
LANE_FN void take_over() { vendor_take_over<PERSISTENT_THREADS>(); }
#endif

// The halo: rows that sums of one block compute and elements of another block read. The owner of a
// row sends the row to the memory of each block that needs it. A barrier in that block counts the
// received bytes. Sending needs no fence, and no thread waits for later stores.
#if PERSISTENT_HALO != 0
constexpr uint32_t kSenders = PERSISTENT_THREADS - VENDOR_WARP * PERSISTENT_MAKERS;
__shared__ uint64_t g_came[2];  // barriers of even and odd turns
__shared__ uint32_t g_halo_bytes;
__shared__ uint32_t g_sends[PERSISTENT_ROUNDS * kSenders];
LANE_FN uint32_t in_shared(const void* p) {
  return vendor_in_shared(p);
}
LANE_FN uint32_t in_block(uint32_t address, uint32_t block) {
  return vendor_in_block(address, block);
}
LANE_FN void begin_barrier() {
  vendor_begin_bytes(in_shared(g_came));
}
// Turns are counted from 0, modulo four. Even and odd turns have separate barriers and rows. The
// parity of a barrier alternates between its own turns.
LANE_FN void expect_rows(const uint32_t turn) {
  vendor_expect_bytes(in_shared(g_came + turn % 2), g_halo_bytes);
}
LANE_FN void wait_halo(const uint32_t turn) {
  vendor_wait_bytes(in_shared(g_came + turn % 2), turn / 2 % 2);
}
// The destination of a row, the lane that has the row, and whether this thread sends a row.
struct halo_send {
  uint32_t to, came, lane, on;
};
LANE_FN void send_row(const halo_send& send, uint32_t base, const four_words& row) {
  vendor_send_words(send.to + base * (uint32_t)sizeof(row), send.came, send.on, row.word);
}
LANE_FN int32_t of_lane(int32_t word, uint32_t lane) {
  return vendor_of_lane(word, lane);
}
LANE_FN four_words* halo_of(const block_memory memory, const uint32_t turn) {
  return memory.rows + PERSISTENT_ITEMS + turn % 2 * PERSISTENT_HALO;
}
struct halo_sends {
  halo_send rounds[PERSISTENT_ROUNDS];
};
// A send is lane << 24 | block << 16 | row, and a flag. Few lanes have a row, but each row goes to
// several blocks, so all lanes of the warp send.
LANE_FN halo_sends begin_sends(const block_memory memory) {
  const uint32_t turn = memory.turn + 1;
  halo_sends sends;
#pragma unroll
  for (uint32_t k = 0; k < PERSISTENT_ROUNDS; ++k) {
    const uint32_t send = g_sends[k * kSenders + threadIdx.x - VENDOR_WARP * PERSISTENT_MAKERS];
    const uint32_t block = send >> 16 & 31;
    sends.rounds[k] = {in_block(in_shared(halo_of(memory, turn) + (send & 0xffff)), block),
                       in_block(in_shared(g_came + turn % 2), block), send >> 24 & 31, send >> 31};
  }
  return sends;
}
template <int width>
LANE_FN void send_rows(const halo_sends& sends, uint32_t base, const int32_t* words) {
#pragma unroll
  for (const halo_send& send : sends.rounds) {
    four_words row;
#pragma unroll
    for (int c = 0; c < 4; ++c) row.word[c] = c < width ? of_lane(words[c], send.lane) : 0;
    send_row(send, base, row);
  }
}
struct halo_rows {
  const four_words* array;
  uint32_t rows;
};
struct halo_row {
  four_words words;
};
// A row of zeros follows the last row of an array. No element reads a row after it: see plan_halo.
LANE_FN halo_row row_of(const halo_rows s, int32_t row, int32_t, vb, int32_t, row_failure&) {
  const uint32_t at = (uint32_t)row < s.rows ? (uint32_t)row : s.rows;
  return {s.array[at]};
}
LANE_FN int32_t column_of(const halo_row r, int32_t column) { return r.words.word[column]; }
// `sends` has the sends of all blocks, followed by the bytes that each block receives.
LANE_FN void begin_halo(const block_memory memory, const uint32_t* sends) {
  for (uint32_t k = threadIdx.x; k < 2 * PERSISTENT_HALO; k += PERSISTENT_THREADS)
    memory.rows[PERSISTENT_ITEMS + k] = {};
  const uint32_t words = PERSISTENT_ROUNDS * kSenders;
  for (uint32_t k = threadIdx.x; k < words; k += PERSISTENT_THREADS)
    g_sends[k] = __ldg(sends + blockIdx.x * words + k);
  if (threadIdx.x != 0) return;
  g_halo_bytes = __ldg(sends + gridDim.x * words + blockIdx.x);
  begin_barrier();
}
// Loads rows of the halo from memory. A record has per array: from, base << 32 | rows, width.
LANE_FN void fill_halo(const block_memory memory, const uint64_t* record) {
  four_words* const halo = halo_of(memory, memory.turn);
  for (uint32_t k = 0; k < (uint32_t)record[1]; ++k) {
    const uint64_t* const fill = record + kHeader + 3 * k;
    const int32_t* const from = in_memory((const int32_t*)fill[0]);
    const uint32_t width = (uint32_t)fill[2];
    for (uint32_t row = threadIdx.x; row < low_half(fill[1]); row += PERSISTENT_THREADS)
      for (uint32_t c = 0; c < width; ++c)
        halo[high_half(fill[1]) + row].word[c] = from[row * width + c];
  }
  __syncthreads();
}
#endif

// `on`: the thread has the row; otherwise it only takes part in the work of its warp. `owns`: the
// thread stores the row, which other blocks may compute too.
LANE_FN void run_chain(uint32_t form, const uint64_t* words, const int64_t i, const bool on,
                       const bool owns, const block_memory memory, const device_sink sink);

constexpr uint32_t kWarps = PERSISTENT_THREADS / VENDOR_WARP;
#if PERSISTENT_LAYOUTS != 0
// The layout of the phase has the row of each thread: see BlockPlan in cluster/blocks.h. A task is
//   form << 48 | the first word of the arguments << 32 | layout << 16 | what the warp does
constexpr uint32_t kWorks = 1, kStores = 2, kHandsOver = 4, kTakesOver = 8, kKeeps = 16;
constexpr uint32_t kSends = 32, kTurnShift = 6, kFills = 256, kLayoutShift = 16;
constexpr uint32_t kOn = 1u << 30, kOwns = 1u << 31;
// Early halves of all phases, as a separate launch. An early half is the part of a Program that can
// run before its phase. A block has kEarlyThreads slots of a job, the early half of a chain:
//   slots << 32 | form     the first word of its arguments     bytes before the layout of its phase
//   its first thread of a block << 32 | threads of a block
#if PERSISTENT_EARLY != 0
constexpr uint32_t kEarlyThreads = 128, kJobWords = 4;
LANE_FN void run_early(uint32_t form, const uint64_t* words, const int64_t i, const uint32_t slot,
                       const device_sink sink);
LANE_FN void run_job(const uint64_t* table, const uint64_t* job, const uint32_t slot,
                     const device_sink sink) {
  if (slot >= high_half(job[0])) return;
  const uint32_t threads = low_half(job[3]), thread = high_half(job[3]) + slot % threads;
  const uint32_t* const rows = (const uint32_t*)((const char*)table + job[2]);
  // Lanes without a row of their own write too, because cache lines with gaps take longer to write.
  const uint32_t row = rows[slot / threads * PERSISTENT_THREADS + thread] & (kOn - 1);
  run_early(low_half(job[0]), table + job[1], row, slot, sink);
}
VENDOR_ENTRY __launch_bounds__(kEarlyThreads) novaphy_early(
    const uint64_t* table, const uint64_t* jobs, const uint32_t blocks_of_job,
    const device_sink sink) {
  run_job(table, jobs + kJobWords * (blockIdx.x / blocks_of_job),
          blockIdx.x % blocks_of_job * kEarlyThreads + threadIdx.x, sink);
}
#endif
__shared__ uint32_t g_rows[PERSISTENT_LAYOUTS * PERSISTENT_THREADS];
LANE_FN void load_layouts(const uint64_t* rows) {
  const uint32_t* const from = (const uint32_t*)rows + blockIdx.x * PERSISTENT_THREADS + threadIdx.x;
  for (uint32_t k = 0; k < PERSISTENT_LAYOUTS; ++k)
    g_rows[k * PERSISTENT_THREADS + threadIdx.x] = __ldg(from + k * gridDim.x * PERSISTENT_THREADS);
}
LANE_FN void run_task(const uint64_t* record, uint64_t task, block_memory memory,
                      const device_sink sink) {
  const uint32_t how = low_half(task);
  memory.turn = how >> kTurnShift & 3;
#if PERSISTENT_HALO != 0
  if ((how & kSends) != 0 && threadIdx.x == VENDOR_WARP * PERSISTENT_MAKERS) {
    wait_halo(memory.turn - 1);
    expect_rows(memory.turn + 1);
  }
  if ((how & kFills) != 0) {
    phase_wait();
    wait_halo(memory.turn);
    fill_halo(memory, record);
    return;
  }
#endif
  if ((how & kWorks) == 0) {
    // As in working warps. In another order, two handovers could fall in one phase.
    if ((how & kTakesOver) != 0) take_over();
    phase_wait();
    if ((how & kHandsOver) != 0) hand_over();
    return;
  }
  const uint32_t row = g_rows[(how >> kLayoutShift) * PERSISTENT_THREADS + threadIdx.x];
  run_chain(high_half(task) >> 16, record + (high_half(task) & 0xffff), row & (kOn - 1),
            (row & kOn) != 0, (row & kOwns) != 0 && (how & (kStores | kKeeps)) != 0,
            memory, sink);
}
LANE_FN bool stores(uint64_t task) { return (low_half(task) & kStores) != 0; }
#elif PERSISTENT_TASKS != 0
// Runs a task. The wait for the previous phase comes after the early part of the chain.
LANE_FN void run_task(const uint64_t* record, uint64_t task, const block_memory memory,
                      const device_sink sink) {
  const uint32_t lane = threadIdx.x % VENDOR_WARP, rows = low_half(task) >> 24;
  if (rows == 0) {
    phase_wait();
    return;
  }
  const bool on = lane < rows;
  run_chain(high_half(task) >> 16, record + (high_half(task) & 0xffff),
            (low_half(task) & 0xffffff) + (on ? lane : 0), on, on, memory, sink);
}
LANE_FN bool stores(uint64_t task) { return low_half(task) >> 24 != 0; }
#else
LANE_FN void run_phase(const uint64_t* record, const device_sink sink) {
  const uint64_t* const chain = record + 2;
  const uint32_t chains = low_half(record[1]) & 0xffff, lanes = low_half(record[1]) >> 16;
  const uint32_t warps = high_half(record[1]), lane = threadIdx.x % VENDOR_WARP;
  // Neighboring warps run in different blocks, so that few warps use many units.
#pragma unroll 1
  for (uint32_t warp = threadIdx.x / VENDOR_WARP * gridDim.x + blockIdx.x; warp < warps;
       warp += gridDim.x * kWarps) {
    uint32_t c = chains - 1;
    while (high_half(chain[2 * c]) > warp) --c;
    const uint32_t row = (warp - high_half(chain[2 * c])) * lanes + lane;
    if (lane < lanes && row < low_half(chain[2 * c]))
      run_chain(high_half(chain[2 * c + 1]), record + low_half(chain[2 * c + 1]), row, true, true,
                {}, sink);
  }
}
#endif

#if PERSISTENT_FORM == 1
#define PERSISTENT_CLUSTER __cluster_dims__(PERSISTENT_BLOCKS, 1, 1)
#else
#define PERSISTENT_CLUSTER
#endif
// Keeps an address in shared memory in a register. Otherwise compilers compute it anew for each
// use, which takes longer in a cluster, where the address depends on the number of the block.
#define stay(p) vendor_stays_shared(p)
struct persistent_start {
  uint64_t words;  // size of the first record
  uint64_t tasks;  // position of the first task
  uint64_t rows;  // position of the rows of threads
  uint64_t turns;  // number of turns of the halo
};
VENDOR_ENTRY PERSISTENT_CLUSTER __launch_bounds__(PERSISTENT_THREADS, 1) novaphy_main(
    const __grid_constant__ persistent_start start, uint64_t* table, const int64_t counters,
    const device_sink sink) {
  // The records of this phase, of the next phase, and of the phase after it, which is being loaded.
  __shared__ uint64_t records[3][PERSISTENT_WORDS];
  uint64_t *record = stay(records[0]), *next = stay(records[1]), *later = stay(records[2]);
#if PERSISTENT_LAYOUTS != 0
  const block_memory memory = {stay(g_items), 0};
#else
  const block_memory memory = {0, 0};
#endif
  uint64_t head = __ldg(table);  // header of the next record, then of the record after it
  bool is_last = high_half(head) == 0;
  for (uint32_t k = threadIdx.x; k < start.words; k += PERSISTENT_THREADS)
    record[k] = __ldg(table + k);
  for (uint32_t k = threadIdx.x; k < high_half(head); k += PERSISTENT_THREADS)
    next[k] = __ldg(table + low_half(head) + k);
  head = is_last ? 0 : __ldg(table + low_half(head));
#if PERSISTENT_TASKS != 0
  const uint64_t* tasks = table + start.tasks + blockIdx.x * kWarps + threadIdx.x / VENDOR_WARP;
  uint64_t task = __ldg(tasks);
#endif
#if PERSISTENT_LAYOUTS != 0
  load_layouts(table + start.rows);
  if (threadIdx.x == 0) begin_items();
#endif
#if PERSISTENT_HALO != 0
  begin_halo(memory, (const uint32_t*)(table + start.rows) +
             PERSISTENT_LAYOUTS * gridDim.x * PERSISTENT_THREADS);
#endif
  __syncthreads();
#if PERSISTENT_TASKS != 0
  phase_arrive(PERSISTENT_HALO != 0);  // other blocks send rows to memory that is zeroed here
#endif
#pragma unroll 1
  for (uint32_t phase = 0;; ++phase) {
    const uint32_t words = high_half(head);
    const uint64_t* const from = table + low_half(head);
    const uint64_t next_head = words != 0 ? __ldg(from) : 0;
    uint64_t loaded[kWordsPerThread];
#pragma unroll
    for (int k = 0; k < kWordsPerThread; ++k) {
      const uint32_t at = threadIdx.x + k * PERSISTENT_THREADS;
      loaded[k] = at < words ? __ldg(from + at) : 0;
    }
#if PERSISTENT_TASKS != 0
    tasks += gridDim.x * kWarps;
    const uint64_t next_task = is_last ? 0 : __ldg(tasks);
#if PERSISTENT_EARLY != 0 && PERSISTENT_HALO != 0
    if (threadIdx.x == PERSISTENT_THREADS - 1) fetch_early(record);
#endif
    run_task(record, task, memory, sink);
    const bool wrote = stores(task);
    task = next_task;
#else
    if (phase != 0) phase_wait((uint32_t*)(table + counters), phase - 1);
    run_phase(record, sink);
    const bool wrote = true;
#endif
    if (is_last) break;
    is_last = words == 0;
    head = next_head;
    // No thread reads the record of the previous phase: all have passed a barrier since.
#pragma unroll
    for (int k = 0; k < kWordsPerThread; ++k) {
      const uint32_t at = threadIdx.x + k * PERSISTENT_THREADS;
      if (at < words) later[at] = loaded[k];
    }
    uint64_t* const done = record;
    record = next;
    next = later;
    later = done;
    phase_arrive(wrote);
  }
#if PERSISTENT_HALO != 0
  // A block leaves only after all rows from other blocks have arrived.
  wait_halo((uint32_t)start.turns + 2);
  wait_halo((uint32_t)start.turns + 3);
#endif
  last_barrier((uint32_t*)(table + counters));
}
