/* A row of one source and then rows of another, those of its items in their order: row by row, all
 * columns at once, so that rows of different length cost no more than they have items. */

typedef float four_floats __attribute__((vector_size(16)));
typedef four_floats four_floats_unaligned __attribute__((aligned(4), may_alias));
/* A source of rows of up to four words. */
typedef struct narrow_rows {
  const char* s;
  int64_t rows;
  uint64_t whole; /* rows that have four words from their first one on */
  int32_t width, source;
} narrow_rows;
LANE_FN narrow_rows narrow(const char* s, int64_t rows, int32_t width, int32_t source) {
  const int64_t whole = rows + 1 - (width + 3) / width;
  return (narrow_rows){s, rows, whole > 0 ? (uint64_t)whole : 0, width, source};
}
/* The last rows have no four words, absent ones (negative) none. */
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
  if (__builtin_expect((uint64_t)row < r->whole, 1))
    return *(const four_floats_unaligned*)(r->s + 4 * row * r->width);
  return part_of_row(r, row, i, sink);
}
/* The rows [i, last) of `out`; returns last. */
LANE_FN int64_t csr_sums(narrow_rows init, narrow_rows terms, const int32_t* offsets,
                         const int32_t* items, int64_t i, int64_t last, novaphy_error_sink* sink,
                         char* out) {
  for (; i < last; ++i) {
    four_floats add = row_of_four(&init, i, i, sink);
    const int32_t end = offsets[i + 1];
    int32_t k = offsets[i];
    if (items == NULL) {
      for (; k < end; ++k) add += row_of_four(&terms, k, i, sink);
    } else {
      for (; k < end; ++k) add += row_of_four(&terms, items[k], i, sink);
    }
    const four_floats sum = add; /* `add` itself stays in a register */
    memcpy(out + 4 * i * init.width, &sum, 4 * (size_t)init.width);
  }
  return i;
}
