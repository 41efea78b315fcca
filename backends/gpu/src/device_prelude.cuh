// The prelude of device code defines the names in emitted source (<novaphy/program/emit.h>) for one
// row per thread. vendors/*.cuh come before the prelude. The build inserts the included files. The
// arithmetic has the bits of backends/cpu/src/lanes.h: no contraction, no flush to zero, and
// correctly rounded division and square root.
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
#define INT32_MAX 2147483647
#define INT32_MIN (-2147483647 - 1)

#define LANE_FN static __device__ __forceinline__
#define COLD_FN static __device__ __noinline__

// The record of a failing read for the host, with the layout of ErrorRecord in device.h. The first
// kernel that fails keeps the record. The smallest failing row wins, whatever the timing.
struct device_error {
  int64_t index;  // INT64_MAX: none
  int64_t row;
  int64_t rows;
  uint32_t kernel;
  int32_t source;
  uint32_t lock;
  uint32_t unused;
};
struct device_sink {
  device_error* record;  // device memory; kZeros words after its start are zeros
  uint32_t* flag;        // host memory: set to 1 with the first record
  uint32_t kernel;
  const int32_t* active;  // null: all rows are computed; else address of the number of rows
};
LANE_FN int64_t active_rows(const device_sink sink, const int64_t n) {
  if (sink.active == 0) return n;
  const int64_t rows = *sink.active;
  return rows < n ? rows : n;
}
COLD_FN void report_row(const device_sink sink, int64_t index, int32_t source, int64_t row,
                        int64_t rows) {
  volatile device_error* const e = sink.record;
  if (index >= e->index) return;  // avoids the lock; tested again below
  bool done = false;
  while (!done) {
    if (atomicExch(&sink.record->lock, 1u) != 0u) continue;
    __threadfence();
    if (index < e->index && (e->index == 0x7fffffffffffffffLL || e->kernel == sink.kernel)) {
      e->index = index;
      e->row = row;
      e->rows = rows;
      e->kernel = sink.kernel;
      e->source = source;
      *(volatile uint32_t*)sink.flag = 1u;
      __threadfence_system();
    }
    __threadfence();
    atomicExch(&sink.record->lock, 0u);
    done = true;
  }
}

// The first failing read of a row. Loads have no branches. An invalid load reads a zero, and this
// struct keeps the failure until the row is done.
#define kZeros 32
struct row_failure {
  const int32_t* zeros;
  int32_t source;  // -1: no failure; in a fused text: kSources * operation + source
  int32_t row;
  uint32_t rows;
  int32_t operation;  // in a fused text: the operation that is running
};
#define kSources 256
LANE_FN row_failure begin_row(const device_sink sink) {
  row_failure f;
  f.zeros = (const int32_t*)sink.record + kZeros;
  f.source = -1;
  f.row = 0;
  f.rows = 0;
  f.operation = 0;
  return f;
}
LANE_FN void note_read(row_failure& f, bool bad, int32_t source, int32_t row, int64_t rows) {
  const bool first = bad && f.source < 0;
  f.source = first ? f.operation * kSources + source : f.source;
  f.row = first ? row : f.row;
  f.rows = first ? (uint32_t)rows : f.rows;
}
LANE_FN void end_row(const row_failure& f, const device_sink sink, int64_t i) {
  if (f.source >= 0) report_row(sink, i, f.source % kSources, f.row, f.rows);
}

// Functions of scalars.
LANE_FN float ubits_f(int32_t a) { return __int_as_float(a); }
LANE_FN int32_t uf_bits(float a) { return __float_as_int(a); }
#include "novaphy/program/scalars.h"
LANE_FN float uabs(float a) { return ubits_f(uf_bits(a) & 0x7fffffff); }
// Division with the compiler's steps, used if an early test shows that all intermediate values are
// normal numbers. The compiler's own test comes late and calls a slow function for zeros. The early
// test has no branches: it collects the extreme magnitudes of all quotients and roots that a thread
// computes. A magnitude is the bits without the sign, times two.
struct magnitudes {
  uint32_t most, least;
};
LANE_FN void note(magnitudes& m, uint32_t most, uint32_t least) {
  m.most = m.most > most ? m.most : most;
  m.least = m.least < least ? m.least : least;
}
LANE_FN uint32_t magnitude(float a) { return (uint32_t)uf_bits(a) << 1; }
// Returns whether all |a| are in [2^-60, 2^60) or 0, which is noted as 0 - 1. Magnitudes are even.
LANE_FN bool are_moderate(const magnitudes m) {
  return m.most < 187u << 24 && m.least >= (67u << 24) - 1;
}
constexpr magnitudes kNoMagnitudes = {0, ~0u};
COLD_FN float divided(float a, float b) { return a / b; }
LANE_FN float quick_div(float a, float b, magnitudes& m) {
  const uint32_t above = magnitude(a), below = magnitude(b);
  note(m, above, above - 1);
  note(m, below, below);
  float r = vendor_rcp_seed(b);
  r = __fmaf_rn(r, __fmaf_rn(r, -b, 1.0f), r);
  const float q = a * r;
  return a == 0.0f ? q : __fmaf_rn(r, __fmaf_rn(q, -b, a), q);
}
LANE_FN float udiv(float a, float b) {
  magnitudes m = kNoMagnitudes;
  const float quotient = quick_div(a, b, m);
  return are_moderate(m) ? quotient : divided(a, b);
}
// Square roots, like the quotients above. Independent quotients and roots share one test, so that a
// thread computes them side by side. A branch after each root would delay the next root.
COLD_FN float rooted(float a) { return __fsqrt_rn(a); }
LANE_FN float quick_sqrt(float a, magnitudes& m) {
  const uint32_t bits = (uint32_t)uf_bits(a);
  note(m, bits >> 31 != 0 ? ~0u : bits << 1, (bits << 1) - 1);
  const float r = vendor_rsqrt_seed(a);
  const float s = a * r;
  return a == 0.0f ? a : __fmaf_rn(__fmaf_rn(-s, s, a), r * 0.5f, s);
}
LANE_FN float usqrt(float a) { return __fsqrt_rn(a); }
LANE_FN float ufma(float a, float b, float c) { return __fmaf_rn(a, b, c); }
LANE_FN float ufloor(float a) { return floorf(a); }
LANE_FN int32_t uf_to_i(float a) {
  const bool fits = a >= -2147483648.0f && a < 2147483648.0f;
  const int32_t outside = a > 0.0f ? INT32_MAX : a < 0.0f ? INT32_MIN : 0;
  return fits ? __float2int_rz(a) : outside;
}
LANE_FN float ui_to_f(int32_t a) { return __int2float_rn(a); }

// One lane per thread: the vector functions are the scalar functions.
#include "novaphy/program/one_lane.h"
#define vdiv udiv

// How a kernel reads a source. The type says what is known about its rows.
//
// Any rows, which may be missing. No operation of a fused list writes `source_constants`.
struct source_rows {
  const char* p;
  int64_t rows;
};
struct source_constants {
  const char* p;
  int64_t rows;
};
// Rows that are known to exist.
struct trusted_rows {
  const char* p;
};
struct trusted_constants {
  const char* p;
};
// The own row, which an earlier operation of a fused list left in registers.
struct source_registers {
  const int32_t* words;
};

// Rows of a table. No kernel writes the table that it gathers from, so these loads may use the
// read-only path. In a persistent kernel another operation may have written the gathered rows.
#ifdef NOVAPHY_PERSISTENT
// The addresses come from a table. Without this conversion the device would test each address for
// shared memory.
#define in_memory(p) vendor_global(p)
#define load_table(p) (*in_memory(p))
#else
#define in_memory(p) (p)
#define load_table(p) __ldg(p)
#endif
typedef int32_t row_lanes;
#define look_at_rows(row) (row)
// One row, looked up once for all of its columns, without a branch: a row that may not be read is
// replaced by zeros. The compiler moves the parts that do not depend on the row out of loops.
struct table_row {
  const int32_t* p;
};
template <class S>
LANE_FN table_row row_of(const S s, int32_t row, int32_t width, vb need, int32_t source,
                         row_failure& sink) {
  // As an unsigned number, a negative row is large.
#ifdef NOVAPHY_PERSISTENT
  const bool outside = (uint32_t)row >= (uint32_t)s.rows;  // persistent kernels: < 2^32 rows
#else
  const bool outside = (uint64_t)row >= (uint64_t)s.rows;
#endif
  note_read(sink, outside && row >= 0 && need, source, row, s.rows);
  table_row r;
  r.p = outside ? sink.zeros : (const int32_t*)s.p + (uint64_t)(uint32_t)row * (uint32_t)width;
  return r;
}
template <class S>
LANE_FN table_row trusted_row(const S s, int32_t row, int32_t width) {
  table_row r;
  r.p = (const int32_t*)s.p + (uint64_t)(uint32_t)row * (uint32_t)width;
  return r;
}
LANE_FN table_row row_of(const trusted_rows s, int32_t row, int32_t width, vb, int32_t,
                         row_failure&) {
  return trusted_row(s, row, width);
}
LANE_FN table_row row_of(const trusted_constants s, int32_t row, int32_t width, vb, int32_t,
                         row_failure&) {
  return trusted_row(s, row, width);
}
LANE_FN int32_t column_of(const table_row r, int32_t column) {
  int32_t word = load_table(r.p + column);
#ifdef NOVAPHY_PERSISTENT
  vendor_is_loaded(word);
#endif
  return word;
}
// A row that a fused list has in registers: the row of an item of a CSR loop, or the first row.
struct source_item {
  const int32_t* words;
};
LANE_FN source_item row_of(const source_item s, int32_t, int32_t, vb, int32_t, row_failure&) {
  return s;
}
LANE_FN int32_t column_of(const source_item r, int32_t column) { return r.words[column]; }

// The own row. The pointers may alias, because an output and an input may be the same rows.
struct own_row {
  const int32_t* p;
};
LANE_FN own_row own_of(const source_rows s, int64_t i, int32_t width, vb need, int32_t source,
                       row_failure& sink) {
  const bool there = i < s.rows;
  note_read(sink, !there && need, source, (int32_t)i, s.rows);
  own_row r;
  r.p = there ? (const int32_t*)s.p + i * width : sink.zeros;
  return r;
}
LANE_FN own_row own_of(const trusted_rows s, int64_t i, int32_t width, vb, int32_t, row_failure&) {
  own_row r;
  r.p = (const int32_t*)s.p + i * width;
  return r;
}
LANE_FN own_row own_of(const source_registers s, int64_t, int32_t, vb, int32_t, row_failure&) {
  own_row r;
  r.p = s.words;
  return r;
}
LANE_FN int32_t own_column_of(const own_row r, int32_t column) { return r.p[column]; }
// The own row of a constant source, loaded once through the read-only path.
struct own_constant_row {
  const int32_t* p;
};
LANE_FN own_constant_row own_of(const source_constants s, int64_t i, int32_t width, vb need,
                                int32_t source, row_failure& sink) {
  const bool there = i < s.rows;
  note_read(sink, !there && need, source, (int32_t)i, s.rows);
  own_constant_row r;
  r.p = there ? (const int32_t*)s.p + i * width : sink.zeros;
  return r;
}
LANE_FN own_constant_row own_of(const trusted_constants s, int64_t i, int32_t width, vb, int32_t,
                                row_failure&) {
  own_constant_row r;
  r.p = (const int32_t*)s.p + i * width;
  return r;
}
LANE_FN int32_t own_column_of(const own_constant_row r, int32_t column) { return __ldg(r.p + column); }

// An output in memory, and an output in registers that is stored later or not at all.
struct output_rows {
  char* p;
};
struct output_registers {
  int32_t* words;
};
LANE_FN void put_columni(const output_rows o, int32_t width, int32_t column, int64_t i, vi a) {
  ((int32_t*)o.p)[i * width + column] = a;
}
LANE_FN void put_columni(const output_registers o, int32_t, int32_t column, int64_t, vi a) {
  o.words[column] = a;
}
struct alignas(16) four_words {
  int32_t word[4];
};
// If `aligned`, rows begin at multiples of four words.
template <int width, bool aligned = false>
LANE_FN void store_row(char* p, int64_t i, const int32_t* words) {
  int32_t* const row = in_memory((int32_t*)p + i * width);
#pragma unroll
  for (int c = 0; c < width; c += aligned ? 4 : 1) {
    if (aligned) {
      *(four_words*)(row + c) = {{words[c], words[c + 1], words[c + 2], words[c + 3]}};
    } else {
      row[c] = words[c];
    }
  }
}
template <int width>
LANE_FN void load_row(const char* p, int64_t i, int32_t* words) {
#pragma unroll
  for (int c = 0; c < width; ++c) words[c] = __ldg((const int32_t*)p + (i * width + c));
}
// Prefetches a row that will be loaded.
LANE_FN void prefetch_row(const char* p, int64_t i, int32_t width) {
  vendor_prefetch((const int32_t*)p + i * width);
}
#define put_columnf(o, width, column, i, a) put_columni(o, width, column, i, uf_bits(a))

#define LANES_ROWS(t, T, bits)                                                                    \
  template <class S>                                                                              \
  LANE_FN T uload##t(const S s, int32_t row, int32_t width, int32_t column, vb need,              \
                     int32_t source, int64_t, row_failure& sink) {                                \
    return bits(column_of(row_of(s, row, width, need, source, sink), column));                    \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN T gather_column##t(const S s, const row_lanes* r, int32_t width, int32_t column,        \
                             vb need, int32_t source, int64_t, row_failure& sink) {               \
    return bits(column_of(row_of(s, *r, width, need, source, sink), column));                     \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN T own_column##t(const S s, int32_t width, int32_t column, vb need, int32_t source,      \
                          int64_t i, row_failure& sink) {                                         \
    return bits(own_column_of(own_of(s, i, width, need, source, sink), column));                  \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void gather2##t(const S s, const row_lanes* r, vb need, int32_t source, int64_t,        \
                          row_failure& sink, T* a, T* b) {                                        \
    const auto row = row_of(s, *r, 2, need, source, sink);                                        \
    *a = bits(column_of(row, 0));                                                                 \
    *b = bits(column_of(row, 1));                                                                 \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void gather3##t(const S s, const row_lanes* r, vb need, int32_t source, int64_t,        \
                          row_failure& sink, T* a, T* b, T* c) {                                  \
    const auto row = row_of(s, *r, 3, need, source, sink);                                        \
    *a = bits(column_of(row, 0));                                                                 \
    *b = bits(column_of(row, 1));                                                                 \
    *c = bits(column_of(row, 2));                                                                 \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void gather4##t(const S s, const row_lanes* r, vb need, int32_t source, int64_t,        \
                          row_failure& sink, T* a, T* b, T* c, T* d) {                            \
    const auto row = row_of(s, *r, 4, need, source, sink);                                        \
    *a = bits(column_of(row, 0));                                                                 \
    *b = bits(column_of(row, 1));                                                                 \
    *c = bits(column_of(row, 2));                                                                 \
    *d = bits(column_of(row, 3));                                                                 \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own2##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink, T* a,    \
                       T* b) {                                                                    \
    const auto row = own_of(s, i, 2, need, source, sink);                                         \
    *a = bits(own_column_of(row, 0));                                                             \
    *b = bits(own_column_of(row, 1));                                                             \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own3##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink, T* a,    \
                       T* b, T* c) {                                                              \
    const auto row = own_of(s, i, 3, need, source, sink);                                         \
    *a = bits(own_column_of(row, 0));                                                             \
    *b = bits(own_column_of(row, 1));                                                             \
    *c = bits(own_column_of(row, 2));                                                             \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own4##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink, T* a,    \
                       T* b, T* c, T* d) {                                                        \
    const auto row = own_of(s, i, 4, need, source, sink);                                         \
    *a = bits(own_column_of(row, 0));                                                             \
    *b = bits(own_column_of(row, 1));                                                             \
    *c = bits(own_column_of(row, 2));                                                             \
    *d = bits(own_column_of(row, 3));                                                             \
  }
LANES_ROWS(f, vf, ubits_f)
LANES_ROWS(i, vi, )
#undef LANES_ROWS

// The rows of a CSR loop.
struct csr_rows {
  int32_t start, longest;
};
LANE_FN csr_rows csr_begin(const int32_t* offsets, int64_t i) {
  csr_rows c;
  c.start = __ldg(offsets + i);
  c.longest = __ldg(offsets + i + 1) - c.start;
  return c;
}
// Short sums add items in batches of CSR_BATCH. The last batch may reach past the end of the row.
#ifndef CSR_BATCH
#define CSR_BATCH 8
#endif
LANE_FN vb csr_on(const csr_rows* c, int32_t r) { return r < c->longest; }
LANE_FN vi csr_slot(const csr_rows* c, const int32_t* items, int32_t r, vb on) {
  const int32_t k = c->start + (on ? r : c->longest - 1);
  return items != 0 ? __ldg(items + k) : k;
}
// The slots of a batch, loaded together. The load of the next batch does not wait for the sums of
// this batch. Slots past the end of a row are 0, an address that all lanes share.
struct csr_batch : csr_rows {
  int32_t slots[CSR_BATCH];
};
LANE_FN void csr_load(csr_batch* c, const int32_t* items, int32_t from) {
  if (from >= c->longest) return;
  int32_t loaded[CSR_BATCH];
#pragma unroll
  for (int32_t r = 0; r < CSR_BATCH; ++r) {
    const int32_t last = c->longest - 1;
    loaded[r] = c->start + (from + r < last ? from + r : last);
  }
  if (items != 0) {
#pragma unroll
    for (int32_t r = 0; r < CSR_BATCH; ++r) loaded[r] = __ldg(items + loaded[r]);
  }
#pragma unroll
  for (int32_t r = 0; r < CSR_BATCH; ++r) c->slots[r] = from + r < c->longest ? loaded[r] : 0;
}
LANE_FN csr_batch csr_begin_batch(const int32_t* offsets, int64_t i) {
  csr_batch c = {};
  (csr_rows&)c = csr_begin(offsets, i);
  return c;
}
// Loads the first batch of a loop. Two argument words are the addresses of offsets and items.
LANE_FN csr_batch csr_first(const uint64_t* args, int32_t word, int32_t, int64_t i) {
  csr_batch c = csr_begin_batch((const int32_t*)args[word], i);
  csr_load(&c, (const int32_t*)args[word + 1], 0);
  return c;
}
LANE_FN vi csr_slot(const csr_batch* c, const int32_t*, int32_t r, vb) { return c->slots[r]; }
