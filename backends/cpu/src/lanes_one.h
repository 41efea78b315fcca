/* Vectors of one lane, as scalars, for launches of few rows and for the rows after the last whole
 * group. */
#include "novaphy/program/one_lane.h"
LANE_FN int lane_of(vb b, int l) {
  (void)l;
  return b;
}

/* How the rows of a group lie in memory, see lanes_gather.h. A single lane has one row. */
typedef struct row_lanes {
  int32_t row;
} row_lanes;
LANE_FN row_lanes look_at_rows(int32_t row) { return (row_lanes){row}; }

LANE_FN vi load_columni(const char* p, int32_t width) {
  (void)width;
  return word_at(p, 0);
}
LANE_FN vf load_columnf(const char* p, int32_t width) { return ubits_f(load_columni(p, width)); }
LANE_FN void load2i(const char* p, vi* a, vi* b) { *a = word_at(p, 0), *b = word_at(p, 1); }
LANE_FN void load3i(const char* p, vi* a, vi* b, vi* c) { load2i(p, a, b), *c = word_at(p, 2); }
LANE_FN void load4i(const char* p, vi* a, vi* b, vi* c, vi* d) {
  load3i(p, a, b, c), *d = word_at(p, 3);
}
LANE_FN void load2f(const char* p, vf* a, vf* b) {
  *a = ubits_f(word_at(p, 0)), *b = ubits_f(word_at(p, 1));
}
LANE_FN void load3f(const char* p, vf* a, vf* b, vf* c) {
  load2f(p, a, b), *c = ubits_f(word_at(p, 2));
}
LANE_FN void load4f(const char* p, vf* a, vf* b, vf* c, vf* d) {
  load3f(p, a, b, c), *d = ubits_f(word_at(p, 3));
}
LANE_FN void load_columns4i(const char* p, int32_t width, vi* a, vi* b, vi* c, vi* d) {
  (void)width;
  load4i(p, a, b, c, d);
}
LANE_FN void load_columns4f(const char* p, int32_t width, vf* a, vf* b, vf* c, vf* d) {
  (void)width;
  load4f(p, a, b, c, d);
}

LANE_FN void store_columni(char* p, int32_t width, vi a) {
  (void)width;
  memcpy(p, &a, 4);
}
LANE_FN void store_columnf(char* p, int32_t width, vf a) { store_columni(p, width, uf_bits(a)); }
LANE_FN void store2i(char* p, vi a, vi b) { memcpy(p, &a, 4), memcpy(p + 4, &b, 4); }
LANE_FN void store3i(char* p, vi a, vi b, vi c) { store2i(p, a, b), memcpy(p + 8, &c, 4); }
LANE_FN void store4i(char* p, vi a, vi b, vi c, vi d) {
  store3i(p, a, b, c), memcpy(p + 12, &d, 4);
}
LANE_FN void store2f(char* p, vf a, vf b) { memcpy(p, &a, 4), memcpy(p + 4, &b, 4); }
LANE_FN void store3f(char* p, vf a, vf b, vf c) { store2f(p, a, b), memcpy(p + 8, &c, 4); }
LANE_FN void take3f(const char* rows, const char* near, int64_t at, vf* a, vf* b, vf* c) {
  load3f(near != NULL ? near + at : rows, a, b, c);
}
LANE_FN void keep3f(char* near, vf a, vf b, vf c) { store3f(near, a, b, c); }
LANE_FN void put3f(char* rows, int streams, vf a, vf b, vf c) {
  (void)streams;
  store3f(rows, a, b, c);
}
LANE_FN void store4f(char* p, vf a, vf b, vf c, vf d) {
  store3f(p, a, b, c), memcpy(p + 12, &d, 4);
}
LANE_FN void store_columns4i(char* p, int32_t width, vi a, vi b, vi c, vi d) {
  (void)width;
  store4i(p, a, b, c, d);
}
LANE_FN void store_columns4f(char* p, int32_t width, vf a, vf b, vf c, vf d) {
  (void)width;
  store4f(p, a, b, c, d);
}
/* Sets a row of `words` words to zero. */
LANE_FN void store_zeros(char* p, int32_t words) { memset(p, 0, 4 * (size_t)words); }
LANE_FN void store9f(char* p, vf a, vf b, vf c, vf d, vf e, vf f, vf g, vf h, vf i) {
  store4f(p, a, b, c, d), store4f(p + 16, e, f, g, h), memcpy(p + 32, &i, 4);
}
LANE_FN void store12f(char* p, vf a, vf b, vf c, vf d, vf e, vf f, vf g, vf h, vf i, vf j, vf k,
                      vf l) {
  store4f(p, a, b, c, d), store4f(p + 16, e, f, g, h), store4f(p + 32, i, j, k, l);
}

/* Returns a row of a table, or zeros for a negative row. A row past the end fails if it is needed.
 */
static const int32_t kZeroRow[4] = {0, 0, 0, 0};
LANE_FN const char* row_or_zeros(const char* s, int64_t rows, int32_t row, int32_t width, vb need,
                                 int32_t source, int64_t i, novaphy_error_sink* sink) {
  if (__builtin_expect(row >= 0 && row < rows, 1)) return s + 4 * ((int64_t)row * width);
  if (row >= 0 && need) report_row(sink, i, source, row);
  return (const char*)kZeroRow;
}
LANE_FN vi gather_columni(const char* s, int64_t rows, const row_lanes* r, int32_t width,
                          int32_t column, vb need, int32_t source, int64_t i,
                          novaphy_error_sink* sink) {
  if (__builtin_expect(r->row >= 0 && r->row < rows, 1))
    return word_at(s, (int64_t)r->row * width + column);
  if (r->row >= 0 && need) report_row(sink, i, source, r->row);
  return 0;
}
LANE_FN vf gather_columnf(const char* s, int64_t rows, const row_lanes* r, int32_t width,
                          int32_t column, vb need, int32_t source, int64_t i,
                          novaphy_error_sink* sink) {
  return ubits_f(gather_columni(s, rows, r, width, column, need, source, i, sink));
}
#define LANES_GATHER(t, T)                                                                         \
  LANE_FN void gather2##t(const char* s, int64_t rows, const row_lanes* r, vb need,                \
                          int32_t source, int64_t i, novaphy_error_sink* sink, T* a, T* b) {       \
    load2##t(row_or_zeros(s, rows, r->row, 2, need, source, i, sink), a, b);                       \
  }                                                                                                \
  LANE_FN void gather3##t(const char* s, int64_t rows, const row_lanes* r, vb need,                \
                          int32_t source, int64_t i, novaphy_error_sink* sink, T* a, T* b, T* c) { \
    load3##t(row_or_zeros(s, rows, r->row, 3, need, source, i, sink), a, b, c);                    \
  }                                                                                                \
  LANE_FN void gather4##t(const char* s, int64_t rows, const row_lanes* r, vb need,                \
                          int32_t source, int64_t i, novaphy_error_sink* sink, T* a, T* b, T* c,   \
                          T* d) {                                                                  \
    load4##t(row_or_zeros(s, rows, r->row, 4, need, source, i, sink), a, b, c, d);                 \
  }
LANES_GATHER(f, vf)
LANES_GATHER(i, vi)
#undef LANES_GATHER

/* Rows that are gathered before they are needed; see lanes_gather.h. */
typedef struct rows_prefetched {
  int32_t row, at;
} rows_prefetched;
LANE_FN int32_t prefetch_limit(int64_t rows) {
  return rows > INT32_MAX ? INT32_MAX : (int32_t)rows - 1;
}
LANE_FN int prefetch_look(rows_prefetched* r, int32_t row, int32_t limit) {
  *r = (rows_prefetched){row, row < 0 ? 0 : row > limit ? limit : row};
  return row > limit;
}
LANE_FN void gather3f_prefetched(const char* s, const rows_prefetched* r, float* to) {
  if (r->row < 0)
    to[0] = to[1] = to[2] = 0.0f;
  else
    memcpy(to, s + 12 * (int64_t)r->at, 12);
}
LANE_FN int gather3f_again(float* to, const char* s, int64_t rows, int32_t limit, int32_t row) {
  if (row >= rows) return 0;
  if (row > limit) memcpy(to, s + 12 * (int64_t)row, 12);
  return 1;
}

/* The items of one CSR row. */
typedef struct csr_rows {
  int32_t start, longest;
} csr_rows;
LANE_FN csr_rows csr_begin(const int32_t* offsets, int64_t i) {
  return (csr_rows){offsets[i], offsets[i + 1] - offsets[i]};
}
LANE_FN vb csr_on(const csr_rows* c, int32_t r) {
  (void)c, (void)r;
  return 1;
}
LANE_FN vi csr_slot(const csr_rows* c, const int32_t* items, int32_t r, vb on) {
  (void)on;
  return items != NULL ? items[c->start + r] : c->start + r;
}
