/* Ordered sums per row: a row of one source plus rows of another source, given by CSR items in
 * their order. The sums run row by row, with all columns of a row in one vector, so that rows of
 * different length cost no more than their items. */

typedef float four_floats __attribute__((vector_size(16)));
typedef four_floats four_floats_unaligned __attribute__((aligned(4), may_alias));
/* A source with rows of up to four words. */
typedef struct narrow_rows {
  const char* s;
  int64_t rows;
  uint64_t whole; /* number of rows from which four words can be read */
  int32_t width, source;
} narrow_rows;
LANE_FN narrow_rows narrow(const char* s, int64_t rows, int32_t width, int32_t source) {
#if LANES == 16 /* a masked load may pass the end of the array */
  const int64_t whole = rows;
#else
  const int64_t whole = rows + 1 - (width + 3) / width;
#endif
  return (narrow_rows){s, rows, whole > 0 ? (uint64_t)whole : 0, width, source};
}
/* Reads a row of which four words cannot be read. A negative row has no words and reads 0. */
COLD_FN four_floats part_of_row(const narrow_rows* r, int64_t row, int64_t i,
                                novaphy_error_sink* sink) {
  float words[4] = {0.0f, 0.0f, 0.0f, 0.0f};
  if (row >= r->rows)
    report_row(sink, i, r->source, row);
  else if (row >= 0)
    memcpy(words, r->s + 4 * row * r->width, 4 * (size_t)r->width);
  return (four_floats){words[0], words[1], words[2], words[3]};
}
LANE_FN four_floats row_of_four(const narrow_rows* r, int64_t row, int64_t i,
                                novaphy_error_sink* sink) {
  if (__builtin_expect((uint64_t)row < r->whole, 1)) {
    const char* const p = r->s + 4 * row * r->width;
#if LANES == 16
    return (four_floats)_mm_maskz_loadu_ps((__mmask8)((1 << r->width) - 1), p);
#else
    return *(const four_floats_unaligned*)p;
#endif
  }
  return part_of_row(r, row, i, sink);
}
LANE_FN void store_row_of_four(char* out, int32_t width, four_floats sum) {
#if LANES == 16
  _mm_mask_storeu_ps(out, (__mmask8)((1 << width) - 1), (__m128)sum);
#else
  const four_floats stored = sum; /* a copy, so that the sum itself stays in a register */
  memcpy(out, &stored, 4 * (size_t)width);
#endif
}

/* Computes the rows [i, last) of `out`, two at the same time, because each addition waits for the
 * previous addition of its row. */
#define CSR_ITEM(k, i) row_of_four(&terms, listed ? items[k] : (k), i, sink)
LANE_FN int64_t csr_sums_of(narrow_rows init, narrow_rows terms, const int32_t* offsets, int listed,
                            const int32_t* items, int64_t i, int64_t last, novaphy_error_sink* sink,
                            char* out) {
  const int32_t bytes = 4 * init.width;
  int64_t k = offsets[i];
  for (; i + 2 <= last; i += 2) {
    four_floats add = row_of_four(&init, i, i, sink), next = row_of_four(&init, i + 1, i + 1, sink);
    const int64_t middle = offsets[i + 1], end = offsets[i + 2];
    int64_t l = middle;
    for (; k < middle && l < end; ++k, ++l) {
      add += CSR_ITEM(k, i);
      next += CSR_ITEM(l, i + 1);
    }
    for (; k < middle; ++k) add += CSR_ITEM(k, i);
    for (; l < end; ++l) next += CSR_ITEM(l, i + 1);
    store_row_of_four(out + bytes * i, init.width, add);
    store_row_of_four(out + bytes * (i + 1), init.width, next);
    k = end;
  }
  for (; i < last; ++i) {
    four_floats add = row_of_four(&init, i, i, sink);
    for (const int64_t end = offsets[i + 1]; k < end; ++k) add += CSR_ITEM(k, i);
    store_row_of_four(out + bytes * i, init.width, add);
  }
  return i;
}
#undef CSR_ITEM
/* Returns the first row that was not computed: last, or i if i >= last. */
LANE_FN int64_t csr_sums(narrow_rows init, narrow_rows terms, const int32_t* offsets,
                         const int32_t* items, int64_t i, int64_t last, novaphy_error_sink* sink,
                         char* out) {
  if (i >= last) return i;
  return items == NULL ? csr_sums_of(init, terms, offsets, 0, items, i, last, sink, out)
                       : csr_sums_of(init, terms, offsets, 1, items, i, last, sink, out);
}
