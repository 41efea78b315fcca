/* Sums over CSR rows that only add the rows of their items: row by row, all columns at once, so
 * that rows of different length cost no more than they have items. The bits are those of any other
 * way, because the items of a row are added in their order. */

typedef float four_floats __attribute__((vector_size(16)));
typedef four_floats four_floats_unaligned __attribute__((aligned(4), may_alias));
/* The last rows of a source have no four words. */
COLD_FN four_floats part_of_row(const char* s, int64_t rows, int32_t row, int32_t width,
                                int32_t source, int64_t i, novaphy_error_sink* sink) {
  float words[4] = {0.0f, 0.0f, 0.0f, 0.0f};
  if (row >= 0 && row < rows) memcpy(words, s + 4 * (int64_t)row * width, 4 * (size_t)width);
  if (row >= rows) report_row(sink, i, source, row);
  return (four_floats){words[0], words[1], words[2], words[3]};
}
LANE_FN void csr_add(const char* s, int64_t rows, int32_t width, const int32_t* offsets,
                     const int32_t* items, int32_t source, int64_t i, novaphy_error_sink* sink,
                     vf* a, vf* b, vf* c, vf* d) {
  four_floats sum[LANES];
  store4f((char*)sum, *a, *b, *c, *d);
  const int64_t whole = rows + 1 - (width + 3) / width;
#define CSR_ADD(k)                                                          \
  {                                                                         \
    const int32_t row = items != NULL ? items[k] : (k);                     \
    if (__builtin_expect(row >= 0 && row < whole, 1))                       \
      add += *(const four_floats_unaligned*)(s + 4 * (int64_t)row * width); \
    else                                                                    \
      add += part_of_row(s, rows, row, width, source, i + l, sink);         \
  }
  for (int l = 0; l < LANES; ++l) {
    four_floats add = sum[l];
    const int32_t end = offsets[i + l + 1];
    int32_t k = offsets[i + l];
    for (; k + 2 <= end; k += 2) {
      CSR_ADD(k)
      CSR_ADD(k + 1)
    }
    if (k < end) CSR_ADD(k)
    sum[l] = add;
  }
#undef CSR_ADD
  load4f((const char*)sum, a, b, c, d);
}
#define CSR_ARGUMENTS                                                                        \
  const char *s, int64_t rows, const int32_t *offsets, const int32_t *items, int32_t source, \
      int64_t i, novaphy_error_sink *sink
LANE_FN void csr_add4(CSR_ARGUMENTS, vf* a, vf* b, vf* c, vf* d) {
  csr_add(s, rows, 4, offsets, items, source, i, sink, a, b, c, d);
}
LANE_FN void csr_add3(CSR_ARGUMENTS, vf* a, vf* b, vf* c) {
  vf none = *a;
  csr_add(s, rows, 3, offsets, items, source, i, sink, a, b, c, &none);
}
LANE_FN void csr_add2(CSR_ARGUMENTS, vf* a, vf* b) {
  vf none[2] = {*a, *a};
  csr_add(s, rows, 2, offsets, items, source, i, sink, a, b, &none[0], &none[1]);
}
LANE_FN void csr_add1(CSR_ARGUMENTS, vf* a) {
  vf none[3] = {*a, *a, *a};
  csr_add(s, rows, 1, offsets, items, source, i, sink, a, &none[0], &none[1], &none[2]);
}
#undef CSR_ARGUMENTS
