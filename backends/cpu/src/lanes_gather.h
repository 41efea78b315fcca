/* Vectors of several lanes: reading rows through an index table, and CSR rows. */

/* How the rows of the lanes lie in memory. Tables often hold the same row for all lanes, or
 * consecutive rows. Loading these is much cheaper than a gather. */
enum { ROWS_SAME, ROWS_CONSECUTIVE, ROWS_ANY };
typedef struct row_lanes {
  vi row;
  int32_t first;
  int kind;
} row_lanes;
LANE_FN row_lanes look_at_rows(vi row) {
  const int32_t first = row[0];
  const vi step = row - first;
  const int kind = all(vieq(step, splati(0)))        ? ROWS_SAME
                   : all(vieq(step, lane_numbers())) ? ROWS_CONSECUTIVE
                                                     : ROWS_ANY;
  return (row_lanes){row, first, kind};
}
LANE_FN int same_row_inside(const row_lanes* r, int64_t rows) {
  return r->kind == ROWS_SAME && r->first >= 0 && r->first < rows;
}
LANE_FN int consecutive_rows_inside(const row_lanes* r, int64_t rows) {
  return r->kind == ROWS_CONSECUTIVE && r->first >= 0 && r->first + LANES <= rows;
}

/* Gathers `columns` neighboring columns of any rows. A negative row reads 0. A row past the end
 * fails if its lane needs it. */
static __attribute__((noinline, unused)) void gather_lanes(vi* target, const char* s, int64_t rows,
                                                           const vi* row, int32_t width,
                                                           int32_t columns, vb need, int32_t source,
                                                           int64_t i, novaphy_error_sink* sink) {
  int32_t word[4][LANES], at[LANES];
  memcpy(at, row, sizeof(at));
  for (int l = 0; l < LANES; ++l) {
    const int64_t r = at[l];
    if (__builtin_expect(r >= 0 && r < rows, 1)) {
      for (int32_t k = 0; k < columns; ++k) word[k][l] = word_at(s, r * width + k);
      continue;
    }
    if (r >= rows && r >= 0 && lane_of(need, l)) report_row(sink, i + l, source, r);
    for (int32_t k = 0; k < columns; ++k) word[k][l] = 0;
  }
  for (int32_t k = 0; k < columns; ++k) memcpy(&target[k], word[k], sizeof(vi));
}

/* Returns whether all rows are below the limit. Negative rows count as below. */
LANE_FN int none_past(vi row, int64_t limit) {
  const int32_t end = limit < 0 ? 0 : limit > INT32_MAX ? INT32_MAX : (int32_t)limit;
  return end > 0 && !any(vile(splati(end), row));
}
/* Returns whether every row lies in [0, limit). */
LANE_FN int all_rows_inside(vi row, int64_t limit) {
  const int32_t end = limit < 0 ? 0 : limit > INT32_MAX ? INT32_MAX : (int32_t)limit;
  return !any(vor(vilt(row, splati(0)), vile(splati(end), row)));
}

#if defined(__x86_64__)
/* Reads four or eight rows of three words at a time. A load of four words also reads the first word
 * of the next row. `at` has the offset of each row, in units of 4 * unit bytes. */
#if LANES == 4
typedef __m128 row_quads;
#define QUADS_OF(l) _mm_loadu_ps((const float*)s + unit * (int64_t)at[l])
#define QUADS(operation) _mm_##operation
#else
typedef __m256 row_quads;
#define QUADS_OF(l)                                                                  \
  _mm256_insertf128_ps(                                                              \
      _mm256_castps128_ps256(_mm_loadu_ps((const float*)s + unit * (int64_t)at[l])), \
      _mm_loadu_ps((const float*)s + unit * (int64_t)at[(l) + 4]), 1)
#define QUADS(operation) _mm256_##operation
#endif
LANE_FN void transpose_rows3(const char* s, const int32_t* at, int unit, row_quads* a, row_quads* b,
                             row_quads* c) {
  const row_quads r0 = QUADS_OF(0), r1 = QUADS_OF(1), r2 = QUADS_OF(2), r3 = QUADS_OF(3);
  const row_quads xy01 = QUADS(unpacklo_ps(r0, r1)), xy23 = QUADS(unpacklo_ps(r2, r3));
  *a = QUADS(shuffle_ps(xy01, xy23, 0x44));
  *b = QUADS(shuffle_ps(xy01, xy23, 0xEE));
  const row_quads z01 = QUADS(unpackhi_ps(r0, r1)), z23 = QUADS(unpackhi_ps(r2, r3));
  *c = QUADS(shuffle_ps(z01, z23, 0x44));
}
#undef QUADS
#undef QUADS_OF
LANE_FN void gather3_inside(const char* s, vi row, vi* a, vi* b, vi* c) {
  int32_t at[LANES];
  memcpy(at, &row, sizeof(at));
#if LANES == 16
  row_quads low[3], high[3];
  transpose_rows3(s, at, 3, &low[0], &low[1], &low[2]);
  transpose_rows3(s, at + 8, 3, &high[0], &high[1], &high[2]);
  *a = (vi)_mm512_insertf32x8(_mm512_castps256_ps512(low[0]), high[0], 1);
  *b = (vi)_mm512_insertf32x8(_mm512_castps256_ps512(low[1]), high[1], 1);
  *c = (vi)_mm512_insertf32x8(_mm512_castps256_ps512(low[2]), high[2], 1);
#else
  transpose_rows3(s, at, 3, (row_quads*)a, (row_quads*)b, (row_quads*)c);
#endif
}
#endif

#if defined(__x86_64__)
/* Gathers rows. An absent row (a negative index) gives 0; its lane reads row 0. */
LANE_FN void gather3_present(const char* s, vi row, vi* a, vi* b, vi* c) {
  const vb absent = vilt(row, splati(0));
  const vi zero = splati(0);
  gather3_inside(s, vselecti(absent, zero, row), a, b, c);
  *a = vselecti(absent, zero, *a), *b = vselecti(absent, zero, *b);
  *c = vselecti(absent, zero, *c);
}
/* Gathers rows of which some are the last row, which has no next row to read a word of. */
COLD_FN void gather3_last(const char* s, int64_t rows, vi row, vi* a, vi* b, vi* c) {
  const vi end = splati((int32_t)(rows - 1));
  const vb last = vieq(row, end);
  gather3_present(s, vselecti(last, splati(0), row), a, b, c);
  s += 12 * (rows - 1);
  *a = vselecti(last, splati(word_at(s, 0)), *a), *b = vselecti(last, splati(word_at(s, 1)), *b);
  *c = vselecti(last, splati(word_at(s, 2)), *c);
}
#endif

/* Rows of three words that are gathered before they are needed. Until then any legal address will
 * do; gather3f_again corrects invalid rows when the group begins. */
typedef struct rows_prefetched {
  int32_t word[LANES]; /* index of the first word of each row */
  vb present;
} rows_prefetched;
/* Returns the last row that can be read with a load of four words, or -1. */
LANE_FN int32_t prefetch_limit(int64_t rows) {
#if defined(__x86_64__)
  rows -= 1; /* the load reads a word of the next row, see transpose_rows3 */
#endif
  return rows > INT32_MAX / 3 ? INT32_MAX / 3 - 1 : rows < 1 ? -1 : (int32_t)rows - 1;
}
/* Computes the addresses of the rows. Returns whether a row is past the limit. */
LANE_FN int prefetch_look(rows_prefetched* r, vi row, int32_t limit) {
  const vi zero = splati(0), end = splati(limit);
  const vi word = 3 * vimin(vimax(row, zero), end);
  memcpy(r->word, &word, sizeof(word));
  /* Forces the words to memory: extracting an address from a vector costs three instructions. */
  __asm__("" : "+m"(r->word));
  r->present = vile(zero, row);
  return any(vilt(end, row));
}
#if LANES == 16
/* Gathers half of the lanes. The processor stores half a vector in half the time. */
LANE_FN void gather3_half(const char* s, const int32_t* word, vb present, float* to) {
  row_quads a, b, c;
  transpose_rows3(s, word, 1, &a, &b, &c);
  _mm256_storeu_ps(to, _mm256_maskz_mov_ps((__mmask8)present, a));
  _mm256_storeu_ps(to + 16, _mm256_maskz_mov_ps((__mmask8)present, b));
  _mm256_storeu_ps(to + 32, _mm256_maskz_mov_ps((__mmask8)present, c));
}
#endif
LANE_FN void gather3f_prefetched(const char* s, rows_prefetched* r, vf* to) {
  /* Makes each gather read the words again. Otherwise the compiler would store a copy for the next
   * gather. */
  __asm__("" : "+m"(r->word));
#if LANES == 16
  gather3_half(s, r->word, r->present, (float*)to);
  gather3_half(s, r->word + 8, (vb)(r->present >> 8), (float*)to + 8);
#else
#if defined(__x86_64__)
  row_quads column[3];
  transpose_rows3(s, r->word, 1, &column[0], &column[1], &column[2]);
#else
  vf column[3];
  for (int l = 0; l < LANES; ++l)
    for (int k = 0; k < 3; ++k) column[k][l] = ubits_f(word_at(s, r->word[l] + (int64_t)k));
#endif
  for (int k = 0; k < 3; ++k) to[k] = vselectf(r->present, (vf)column[k], splatf(0.0f));
#endif
}
/* Reads the rows past the limit again. Returns 0 if a row is past the end of the array. */
COLD_FN int gather3f_again(vf* to, const char* s, int64_t rows, int32_t limit, vi row) {
  if (!none_past(row, rows)) return 0;
  const vb past = vilt(splati(limit), row);
  if (any(vilt(splati(limit + 1), row))) {
    gather_lanes((vi*)to, s, rows, &row, 3, 3, splatb(0), 0, 0, NULL);
  } else if (any(past)) { /* usually only the last row, which has no next row */
    for (int k = 0; k < 3; ++k)
      to[k] = vselectf(past, splatf(ubits_f(word_at(s, 3 * ((int64_t)limit + 1) + k))), to[k]);
  }
  return 1;
}

#define GATHER_ARGUMENTS const char *s, int64_t rows, const row_lanes *r
#define GATHER_ERROR vb need, int32_t source, int64_t i, novaphy_error_sink *sink

LANE_FN vi gather_columni(GATHER_ARGUMENTS, int32_t width, int32_t column, GATHER_ERROR) {
  if (same_row_inside(r, rows)) return splati(word_at(s, (int64_t)r->first * width + column));
  if (consecutive_rows_inside(r, rows))
    return load_columni(s + 4 * ((int64_t)r->first * width + column), width);
#if LANES >= 8
  if (width == 1 && all_rows_inside(r->row, rows)) {
#if LANES == 8
    return (vi)_mm256_i32gather_epi32((const int*)s, (__m256i)r->row, 4);
#else
    return (vi)_mm512_i32gather_epi32((__m512i)r->row, s, 4);
#endif
  }
#endif
  vi target[1];
  gather_lanes(target, s + 4 * column, rows, &r->row, width, 1, need, source, i, sink);
  return target[0];
}
LANE_FN void gather2i(GATHER_ARGUMENTS, GATHER_ERROR, vi* a, vi* b) {
  const char* const p = s + 8 * (int64_t)r->first;
  if (same_row_inside(r, rows)) {
    *a = splati(word_at(p, 0)), *b = splati(word_at(p, 1));
  } else if (consecutive_rows_inside(r, rows)) {
    load2i(p, a, b);
  } else {
    vi target[2];
    gather_lanes(target, s, rows, &r->row, 2, 2, need, source, i, sink);
    *a = target[0], *b = target[1];
  }
}
LANE_FN void gather3i(GATHER_ARGUMENTS, GATHER_ERROR, vi* a, vi* b, vi* c) {
  const char* const p = s + 12 * (int64_t)r->first;
  if (same_row_inside(r, rows)) {
    *a = splati(word_at(p, 0)), *b = splati(word_at(p, 1)), *c = splati(word_at(p, 2));
  } else if (consecutive_rows_inside(r, rows)) {
    load3i(p, a, b, c);
#if defined(__x86_64__)
  } else if (all_rows_inside(r->row, rows - 1)) {
    gather3_inside(s, r->row, a, b, c);
  } else if (none_past(r->row, rows - 1)) {
    gather3_present(s, r->row, a, b, c);
  } else if (rows > 1 && none_past(r->row, rows)) {
    gather3_last(s, rows, r->row, a, b, c);
#endif
  } else {
    vi target[3];
    gather_lanes(target, s, rows, &r->row, 3, 3, need, source, i, sink);
    *a = target[0], *b = target[1], *c = target[2];
  }
}
LANE_FN void gather4i(GATHER_ARGUMENTS, GATHER_ERROR, vi* a, vi* b, vi* c, vi* d) {
  const char* const p = s + 16 * (int64_t)r->first;
  if (same_row_inside(r, rows)) {
    *a = splati(word_at(p, 0)), *b = splati(word_at(p, 1)), *c = splati(word_at(p, 2)),
    *d = splati(word_at(p, 3));
  } else if (consecutive_rows_inside(r, rows)) {
    load4i(p, a, b, c, d);
  } else {
    vi target[4];
    gather_lanes(target, s, rows, &r->row, 4, 4, need, source, i, sink);
    *a = target[0], *b = target[1], *c = target[2], *d = target[3];
  }
}
LANE_FN vf gather_columnf(GATHER_ARGUMENTS, int32_t width, int32_t column, GATHER_ERROR) {
  return (vf)gather_columni(s, rows, r, width, column, need, source, i, sink);
}
LANE_FN void gather2f(GATHER_ARGUMENTS, GATHER_ERROR, vf* a, vf* b) {
  gather2i(s, rows, r, need, source, i, sink, (vi*)a, (vi*)b);
}
LANE_FN void gather3f(GATHER_ARGUMENTS, GATHER_ERROR, vf* a, vf* b, vf* c) {
  gather3i(s, rows, r, need, source, i, sink, (vi*)a, (vi*)b, (vi*)c);
}
LANE_FN void gather4f(GATHER_ARGUMENTS, GATHER_ERROR, vf* a, vf* b, vf* c, vf* d) {
  gather4i(s, rows, r, need, source, i, sink, (vi*)a, (vi*)b, (vi*)c, (vi*)d);
}

/* CSR rows of a group of lanes. Most groups have rows of equal length. Their items then form a
 * packed table of that width. */
typedef struct csr_rows {
  vi start, length;
  int32_t longest;
  int32_t width; /* length of all rows, or -1 if lengths differ */
} csr_rows;
LANE_FN csr_rows csr_begin(const int32_t* offsets, int64_t i) {
  const vi start = load_lanes((const char*)(offsets + i));
  const vi length = load_lanes((const char*)(offsets + i + 1)) - start;
  const int32_t first = length[0];
  csr_rows c = {start, length, first, first};
  if (!all(vieq(length, splati(first)))) {
    c.width = -1;
    for (int l = 1; l < LANES; ++l)
      if (length[l] > c.longest) c.longest = length[l];
  }
  return c;
}
LANE_FN vb csr_on(const csr_rows* c, int32_t r) { return vilt(splati(r), c->length); }
/* A lane whose row has ended gets -1, which reads as an absent neighbor. */
LANE_FN vi csr_slot(const csr_rows* c, const int32_t* items, int32_t r, vb on) {
  if (items == NULL) return vselecti(on, c->start + r, splati(-1));
  const char* const p = (const char*)(items + c->start[0]);
  if (c->width == 1) return load_lanes(p);
  if (c->width == 2) {
    vi a, b;
    load2i(p, &a, &b);
    return r == 0 ? a : b;
  }
  vi slot;
  for (int l = 0; l < LANES; ++l) slot[l] = lane_of(on, l) ? items[c->start[l] + r] : -1;
  return slot;
}
#undef GATHER_ARGUMENTS
#undef GATHER_ERROR
