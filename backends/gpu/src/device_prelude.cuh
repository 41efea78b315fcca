// The prelude of device code: what the names in emitted text mean for the one row of a thread (see
// <novaphy/program/emit.h>). Needs no header: the build puts the text of those that it includes in
// their place. The arithmetic is that of backends/cpu/src/lanes.h, to the bit. Compiled without
// contraction, without flush to zero, and with correctly rounded division and square root.
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

// What a failing read leaves for the host; the layout is that of ErrorRecord in device.h. The first
// kernel that fails keeps the record; of its rows the smallest wins, whatever the timing.
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
  device_error* record;  // device memory; zeros lie kZeros words behind its start
  uint32_t* flag;        // host memory: 1 once there is a record
  uint32_t kernel;
};
COLD_FN void report_row(const device_sink sink, int64_t index, int32_t source, int64_t row,
                        int64_t rows) {
  volatile device_error* const e = sink.record;
  if (index >= e->index) return;  // spares the lock; asked again below
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

// The first failing read of a row. Loads never branch: one that may not be read reads a zero, and what
// was wrong is kept here until the row is done.
#define kZeros 32
struct row_failure {
  const int32_t* zeros;
  int32_t source;  // -1: none
  int32_t row;
  uint32_t rows;
};
LANE_FN row_failure begin_row(const device_sink sink) {
  row_failure f;
  f.zeros = (const int32_t*)sink.record + kZeros;
  f.source = -1;
  f.row = 0;
  f.rows = 0;
  return f;
}
LANE_FN void note_read(row_failure& f, bool bad, int32_t source, int32_t row, int64_t rows) {
  const bool first = bad && f.source < 0;
  f.source = first ? source : f.source;
  f.row = first ? row : f.row;
  f.rows = first ? (uint32_t)rows : f.rows;
}
LANE_FN void end_row(const row_failure& f, const device_sink sink, int64_t i) {
  if (f.source >= 0) report_row(sink, i, f.source, f.row, f.rows);
}

// Scalars.
LANE_FN float ubits_f(int32_t a) { return __int_as_float(a); }
LANE_FN int32_t uf_bits(float a) { return __float_as_int(a); }
#include "novaphy/program/scalars.h"
LANE_FN float uabs(float a) { return ubits_f(uf_bits(a) & 0x7fffffff); }
LANE_FN float usqrt(float a) { return __fsqrt_rn(a); }
LANE_FN float ufma(float a, float b, float c) { return __fmaf_rn(a, b, c); }
LANE_FN float ufloor(float a) { return floorf(a); }
LANE_FN int32_t uf_to_i(float a) {
  const bool fits = a >= -2147483648.0f && a < 2147483648.0f;
  const int32_t outside = a > 0.0f ? INT32_MAX : a < 0.0f ? INT32_MIN : 0;
  return fits ? __float2int_rz(a) : outside;
}
LANE_FN float ui_to_f(int32_t a) { return __int2float_rn(a); }

// One lane: the scalars themselves.
#include "novaphy/program/one_lane.h"

// In place of a number of rows: the host has made sure that every row that is read is there.
#define kTrustedRows ((int64_t)-1 << 62)

// Rows of a table. No kernel writes what it gathers from, so these loads may use the read-only path.
typedef int32_t row_lanes;
#define look_at_rows(row) (row)
LANE_FN int32_t table_word(const char* p, int64_t rows, int32_t row, int32_t width, int32_t column,
                           vb need, int32_t source, int64_t i, row_failure& sink) {
  if (rows == kTrustedRows) return __ldg((const int32_t*)p + ((int64_t)row * width + column));
  // Without a branch: the last row stands in for one that may not be read, and zeros for a source
  // without rows. What does not depend on the row is found once by the compiler.
  const bool empty = rows <= 0;
  const int32_t* const table = empty ? sink.zeros : (const int32_t*)p;
  const uint32_t last = empty ? 0u : (rows > INT32_MAX ? (uint32_t)INT32_MAX : (uint32_t)rows) - 1u;
  const bool outside = empty || (uint32_t)row > last;  // a negative row is a large unsigned one
  note_read(sink, outside && row >= 0 && need, source, row, rows);
  const uint32_t at = (uint32_t)row > last ? last : (uint32_t)row;
  const int32_t value = __ldg(table + ((int64_t)at * width + column));
  return outside ? 0 : value;
}
LANE_FN int32_t uloadi(const char* p, int64_t rows, int32_t row, int32_t width, int32_t column,
                       vb need, int32_t source, int64_t i, row_failure& sink) {
  return table_word(p, rows, row, width, column, need, source, i, sink);
}
LANE_FN float uloadf(const char* p, int64_t rows, int32_t row, int32_t width, int32_t column,
                     vb need, int32_t source, int64_t i, row_failure& sink) {
  return ubits_f(table_word(p, rows, row, width, column, need, source, i, sink));
}
LANE_FN vi gather_columni(const char* p, int64_t rows, const row_lanes* r, int32_t width,
                          int32_t column, vb need, int32_t source, int64_t i,
                          row_failure& sink) {
  return table_word(p, rows, *r, width, column, need, source, i, sink);
}
LANE_FN vf gather_columnf(const char* p, int64_t rows, const row_lanes* r, int32_t width,
                          int32_t column, vb need, int32_t source, int64_t i,
                          row_failure& sink) {
  return ubits_f(table_word(p, rows, *r, width, column, need, source, i, sink));
}

// The own row of a source in memory, and of an output. Through pointers that may alias: an output
// may be the same rows as an input.
struct source_rows {
  const char* p;
  int64_t rows;
};
struct output_rows {
  char* p;
};
LANE_FN vi own_columni(const source_rows s, int32_t width, int32_t column, vb need, int32_t source,
                       int64_t i, row_failure& sink) {
  const bool there = i < s.rows;
  note_read(sink, !there && need, source, (int32_t)i, s.rows);
  return *(there ? (const int32_t*)s.p + (i * width + column) : sink.zeros);
}
LANE_FN void put_columni(const output_rows o, int32_t width, int32_t column, int64_t i, vi a) {
  ((int32_t*)o.p)[i * width + column] = a;
}

// The own row of a source that no operation of a fused list writes: loaded once.
struct source_constants {
  const char* p;
  int64_t rows;
};
LANE_FN vi own_columni(const source_constants s, int32_t width, int32_t column, vb need,
                       int32_t source, int64_t i, row_failure& sink) {
  const bool there = i < s.rows;
  note_read(sink, !there && need, source, (int32_t)i, s.rows);
  return __ldg(there ? (const int32_t*)s.p + (i * width + column) : sink.zeros);
}

// Sources of a fused list whose rows are known to be there; `trusted_constants` no operation of the
// list writes.
struct trusted_constants {
  const char* p;
  static constexpr int64_t rows = kTrustedRows;
};
LANE_FN vi own_columni(const trusted_constants s, int32_t width, int32_t column, vb, int32_t,
                       int64_t i, row_failure&) {
  return __ldg((const int32_t*)s.p + (i * width + column));
}
struct trusted_rows {
  const char* p;
  static constexpr int64_t rows = kTrustedRows;
};
LANE_FN vi own_columni(const trusted_rows s, int32_t width, int32_t column, vb, int32_t, int64_t i,
                       row_failure&) {
  return ((const int32_t*)s.p)[i * width + column];
}

// The own row in registers: what an earlier operation of a fused list left, and what one leaves.
struct source_registers {
  const int32_t* words;
};
struct output_registers {
  char* p;
  int32_t* words;
};
LANE_FN vi own_columni(const source_registers s, int32_t, int32_t column, vb, int32_t, int64_t,
                       row_failure&) {
  return s.words[column];
}
LANE_FN void put_columni(const output_registers o, int32_t width, int32_t column, int64_t i, vi a) {
  o.words[column] = a;
  ((int32_t*)o.p)[i * width + column] = a;
}

#define put_columnf(o, width, column, i, a) put_columni(o, width, column, i, uf_bits(a))
template <class S>
LANE_FN vf own_columnf(const S s, int32_t width, int32_t column, vb need, int32_t source, int64_t i,
                       row_failure& sink) {
  return ubits_f(own_columni(s, width, column, need, source, i, sink));
}
#define LANES_ROWS(t, T)                                                                          \
  LANE_FN void gather2##t(const char* p, int64_t n, const row_lanes* r, vb need, int32_t source,  \
                          int64_t i, row_failure& sink, T* a, T* b) {                        \
    *a = gather_column##t(p, n, r, 2, 0, need, source, i, sink);                                  \
    *b = gather_column##t(p, n, r, 2, 1, need, source, i, sink);                                  \
  }                                                                                               \
  LANE_FN void gather3##t(const char* p, int64_t n, const row_lanes* r, vb need, int32_t source,  \
                          int64_t i, row_failure& sink, T* a, T* b, T* c) {                  \
    *a = gather_column##t(p, n, r, 3, 0, need, source, i, sink);                                  \
    *b = gather_column##t(p, n, r, 3, 1, need, source, i, sink);                                  \
    *c = gather_column##t(p, n, r, 3, 2, need, source, i, sink);                                  \
  }                                                                                               \
  LANE_FN void gather4##t(const char* p, int64_t n, const row_lanes* r, vb need, int32_t source,  \
                          int64_t i, row_failure& sink, T* a, T* b, T* c, T* d) {            \
    *a = gather_column##t(p, n, r, 4, 0, need, source, i, sink);                                  \
    *b = gather_column##t(p, n, r, 4, 1, need, source, i, sink);                                  \
    *c = gather_column##t(p, n, r, 4, 2, need, source, i, sink);                                  \
    *d = gather_column##t(p, n, r, 4, 3, need, source, i, sink);                                  \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own2##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink,     \
                       T* a, T* b) {                                                              \
    *a = own_column##t(s, 2, 0, need, source, i, sink);                                           \
    *b = own_column##t(s, 2, 1, need, source, i, sink);                                           \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own3##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink,     \
                       T* a, T* b, T* c) {                                                        \
    *a = own_column##t(s, 3, 0, need, source, i, sink);                                           \
    *b = own_column##t(s, 3, 1, need, source, i, sink);                                           \
    *c = own_column##t(s, 3, 2, need, source, i, sink);                                           \
  }                                                                                               \
  template <class S>                                                                              \
  LANE_FN void own4##t(const S s, vb need, int32_t source, int64_t i, row_failure& sink,     \
                       T* a, T* b, T* c, T* d) {                                                  \
    *a = own_column##t(s, 4, 0, need, source, i, sink);                                           \
    *b = own_column##t(s, 4, 1, need, source, i, sink);                                           \
    *c = own_column##t(s, 4, 2, need, source, i, sink);                                           \
    *d = own_column##t(s, 4, 3, need, source, i, sink);                                           \
  }
LANES_ROWS(f, vf)
LANES_ROWS(i, vi)
#undef LANES_ROWS

// CSR rows.
struct csr_rows {
  int32_t start, longest;
};
LANE_FN csr_rows csr_begin(const int32_t* offsets, int64_t i) {
  csr_rows c;
  c.start = __ldg(offsets + i);
  c.longest = __ldg(offsets + i + 1) - c.start;
  return c;
}
LANE_FN vb csr_on(const csr_rows*, int32_t) { return 1; }
LANE_FN vi csr_slot(const csr_rows* c, const int32_t* items, int32_t r, vb) {
  return items != 0 ? __ldg(items + (c->start + r)) : c->start + r;
}
