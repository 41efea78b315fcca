/* Vectors of several lanes: rows in memory. Rows are tightly packed. A group of rows {n, 3} is
 * loaded as a whole and split into columns in registers. */

LANE_FN vi load_lanes(const char* p) { return *(const vi_unaligned*)p; }
LANE_FN void store_lanes(char* p, vi a) { *(vi_unaligned*)p = a; }

#if defined(__x86_64__)
/* Loads one word of each of four rows, `stride` words apart, in registers. Compilers would collect
 * single words in memory. */
LANE_FN __m128i load_four(const char* p, int64_t stride) {
#define LANES_WORD(l) _mm_cvtsi32_si128(word_at(p, (l)*stride))
  const __m128i low = _mm_unpacklo_epi32(LANES_WORD(0), LANES_WORD(1));
  const __m128i high = _mm_unpacklo_epi32(LANES_WORD(2), LANES_WORD(3));
  return _mm_unpacklo_epi64(low, high);
#undef LANES_WORD
}
LANE_FN void store_four(char* p, int64_t stride, __m128i a) {
  const int32_t w0 = _mm_cvtsi128_si32(a), w1 = _mm_cvtsi128_si32(_mm_shuffle_epi32(a, 0x55)),
                w2 = _mm_cvtsi128_si32(_mm_unpackhi_epi32(a, a)),
                w3 = _mm_cvtsi128_si32(_mm_shuffle_epi32(a, 0xFF));
  memcpy(p, &w0, 4), memcpy(p + 4 * stride, &w1, 4);
  memcpy(p + 8 * stride, &w2, 4), memcpy(p + 12 * stride, &w3, 4);
}
LANE_FN vi load_columni(const char* p, int32_t width) {
  if (width == 1) return load_lanes(p);
  const int64_t stride = width;
#if LANES == 4
  return (vi)load_four(p, stride);
#elif LANES == 8
  return (vi)_mm256_inserti128_si256(_mm256_castsi128_si256(load_four(p, stride)),
                                     load_four(p + 16 * stride, stride), 1);
#else
  const __m512i first = _mm512_castsi128_si512(load_four(p, stride));
  const __m512i two = _mm512_inserti32x4(first, load_four(p + 16 * stride, stride), 1);
  const __m512i three = _mm512_inserti32x4(two, load_four(p + 32 * stride, stride), 2);
  return (vi)_mm512_inserti32x4(three, load_four(p + 48 * stride, stride), 3);
#endif
}
LANE_FN void store_columni(char* p, int32_t width, vi a) {
  if (width == 1) {
    store_lanes(p, a);
    return;
  }
  const int64_t stride = width;
#if LANES == 4
  store_four(p, stride, (__m128i)a);
#elif LANES == 8
  store_four(p, stride, _mm256_castsi256_si128((__m256i)a));
  store_four(p + 16 * stride, stride, _mm256_extracti128_si256((__m256i)a, 1));
#else
  store_four(p, stride, _mm512_castsi512_si128((__m512i)a));
  store_four(p + 16 * stride, stride, _mm512_extracti32x4_epi32((__m512i)a, 1));
  store_four(p + 32 * stride, stride, _mm512_extracti32x4_epi32((__m512i)a, 2));
  store_four(p + 48 * stride, stride, _mm512_extracti32x4_epi32((__m512i)a, 3));
#endif
}
#else
#define LANES_STRIDED(l) word_at(p, (int64_t)(l)*width)
LANE_FN vi load_columni(const char* p, int32_t width) {
  if (width == 1) return load_lanes(p);
  return (vi){LANE_LIST(LANES_STRIDED)};
}
LANE_FN void store_columni(char* p, int32_t width, vi a) {
  if (width == 1) {
    store_lanes(p, a);
    return;
  }
  for (int l = 0; l < LANES; ++l) {
    const int32_t w = a[l];
    memcpy(p + 4 * (int64_t)l * width, &w, 4);
  }
}
#endif

LANE_FN void load2i(const char* p, vi* a, vi* b) {
#if LANES == 4
  const vi x = load_lanes(p), y = load_lanes(p + 16);
  *a = __builtin_shufflevector(x, y, 0, 2, 4, 6);
  *b = __builtin_shufflevector(x, y, 1, 3, 5, 7);
#elif LANES == 8
  const __m256 x = (__m256)load_lanes(p), y = (__m256)load_lanes(p + 32);
  const __m256 low = _mm256_permute2f128_ps(x, y, 0x20), high = _mm256_permute2f128_ps(x, y, 0x31);
  *a = (vi)_mm256_shuffle_ps(low, high, 0x88);
  *b = (vi)_mm256_shuffle_ps(low, high, 0xDD);
#else
#define LANES_EVEN(l) 2 * (l)
#define LANES_ODD(l) 2 * (l) + 1
  const __m512i x = (__m512i)load_lanes(p), y = (__m512i)load_lanes(p + 64);
  *a = (vi)_mm512_permutex2var_epi32(x, (__m512i)(vi){LANE_LIST(LANES_EVEN)}, y);
  *b = (vi)_mm512_permutex2var_epi32(x, (__m512i)(vi){LANE_LIST(LANES_ODD)}, y);
#endif
}

#if LANES == 16
/* Word 3 l + k of three vectors: below 32 from the first two vectors, else from the third. */
#define LANES_TAKE3_0(l) (3 * (l)) & 31
#define LANES_TAKE3_1(l) (3 * (l) + 1) & 31
#define LANES_TAKE3_2(l) (3 * (l) + 2) & 31
LANE_FN vi take3(__m512i x, __m512i y, __m512i z, vi word, __mmask16 from_z) {
  const __m512i low = _mm512_permutex2var_epi32(x, (__m512i)word, y);
  return (vi)_mm512_mask_permutexvar_epi32(low, from_z, (__m512i)word, z);
}
LANE_FN void load3i(const char* p, vi* a, vi* b, vi* c) {
  const __m512i x = (__m512i)load_lanes(p), y = (__m512i)load_lanes(p + 64),
                z = (__m512i)load_lanes(p + 128);
  *a = take3(x, y, z, (vi){LANE_LIST(LANES_TAKE3_0)}, 0xF800);
  *b = take3(x, y, z, (vi){LANE_LIST(LANES_TAKE3_1)}, 0xF800);
  *c = take3(x, y, z, (vi){LANE_LIST(LANES_TAKE3_2)}, 0xFC00);
}
/* Word w of the row-major store is column w % 3 of row w / 3. */
#define LANES_ROW0(w) (w) / 3 + ((w) % 3 == 1 ? 16 : 0)
#define LANES_ROW1(w) ((w) + 16) / 3 + (((w) + 16) % 3 == 1 ? 16 : 0)
#define LANES_ROW2(w) ((w) + 32) / 3 + (((w) + 32) % 3 == 1 ? 16 : 0)
LANE_FN vi give3(vi a, vi b, vi c, vi row, __mmask16 from_c) {
  const __m512i ab = _mm512_permutex2var_epi32((__m512i)a, (__m512i)row, (__m512i)b);
  return (vi)_mm512_mask_permutexvar_epi32(ab, from_c, (__m512i)row, (__m512i)c);
}
typedef struct rows3 {
  vi part[3];
} rows3;
LANE_FN rows3 pack3(vi a, vi b, vi c) {
  return (rows3){{give3(a, b, c, (vi){LANE_LIST(LANES_ROW0)}, 0x4924),
                  give3(a, b, c, (vi){LANE_LIST(LANES_ROW1)}, 0x2492),
                  give3(a, b, c, (vi){LANE_LIST(LANES_ROW2)}, 0x9249)}};
}
LANE_FN void store_rows3(char* p, const rows3* rows) {
  for (int k = 0; k < 3; ++k) store_lanes(p + 64 * k, rows->part[k]);
}
LANE_FN void store3i(char* p, vi a, vi b, vi c) {
  const rows3 rows = pack3(a, b, c);
  store_rows3(p, &rows);
}
#elif defined(__x86_64__)
/* The two halves of a vector of 8 work like a vector of 4: rows 0 to 3, and rows 4 to 7. */
#if LANES == 8
typedef __m256 quad;
#define QUAD_SHUFFLE(a, b, d, c, e, f) _mm256_shuffle_ps(a, b, _MM_SHUFFLE(d, c, e, f))
LANE_FN quad load_quad(const char* p, int part) {
  const __m128 low = _mm_loadu_ps((const float*)(p + 16 * part));
  return _mm256_insertf128_ps(_mm256_castps128_ps256(low),
                              _mm_loadu_ps((const float*)(p + 16 * part + 48)), 1);
}
LANE_FN void store_quads(char* p, quad q0, quad q1, quad q2) {
  float* const f = (float*)p;
  _mm256_storeu_ps(f, _mm256_permute2f128_ps(q0, q1, 0x20));
  _mm256_storeu_ps(f + 8, _mm256_blend_ps(q2, q0, 0xF0));
  _mm256_storeu_ps(f + 16, _mm256_permute2f128_ps(q1, q2, 0x31));
}
#else
typedef __m128 quad;
#define QUAD_SHUFFLE(a, b, d, c, e, f) _mm_shuffle_ps(a, b, _MM_SHUFFLE(d, c, e, f))
LANE_FN quad load_quad(const char* p, int part) {
  return _mm_loadu_ps((const float*)(p + 16 * part));
}
LANE_FN void store_quads(char* p, quad q0, quad q1, quad q2) {
  float* const f = (float*)p;
  _mm_storeu_ps(f, q0), _mm_storeu_ps(f + 4, q1), _mm_storeu_ps(f + 8, q2);
}
#endif
LANE_FN void load3i(const char* p, vi* a, vi* b, vi* c) {
  const quad m0 = load_quad(p, 0), m1 = load_quad(p, 1), m2 = load_quad(p, 2);
  const quad xy = QUAD_SHUFFLE(m1, m2, 2, 1, 3, 2), yz = QUAD_SHUFFLE(m0, m1, 1, 0, 2, 1);
  *a = (vi)QUAD_SHUFFLE(m0, xy, 2, 0, 3, 0);
  *b = (vi)QUAD_SHUFFLE(yz, xy, 3, 1, 2, 0);
  *c = (vi)QUAD_SHUFFLE(yz, m2, 3, 0, 3, 1);
}
LANE_FN void store3i(char* p, vi a, vi b, vi c) {
  const quad x = (quad)a, y = (quad)b, z = (quad)c;
  const quad xy = QUAD_SHUFFLE(x, y, 2, 0, 2, 0), yz = QUAD_SHUFFLE(y, z, 3, 1, 3, 1),
             zx = QUAD_SHUFFLE(z, x, 3, 1, 2, 0);
  store_quads(p, QUAD_SHUFFLE(xy, zx, 2, 0, 2, 0), QUAD_SHUFFLE(yz, xy, 3, 1, 2, 0),
              QUAD_SHUFFLE(zx, yz, 3, 1, 3, 1));
}
#elif defined(__aarch64__)
LANE_FN void load3i(const char* p, vi* a, vi* b, vi* c) {
  const int32x4x3_t rows = vld3q_s32((const int32_t*)p);
  *a = (vi)rows.val[0], *b = (vi)rows.val[1], *c = (vi)rows.val[2];
}
LANE_FN void store3i(char* p, vi a, vi b, vi c) {
  const int32x4x3_t rows = {{(int32x4_t)a, (int32x4_t)b, (int32x4_t)c}};
  vst3q_s32((int32_t*)p, rows);
}
#else
LANE_FN void load3i(const char* p, vi* a, vi* b, vi* c) {
  *a = load_columni(p, 3), *b = load_columni(p + 4, 3), *c = load_columni(p + 8, 3);
}
LANE_FN void store3i(char* p, vi a, vi b, vi c) {
  store_columni(p, 3, a), store_columni(p + 4, 3, b), store_columni(p + 8, 3, c);
}
#endif

/* Loads four neighboring columns of rows of `width` words. */
#if defined(__x86_64__)
/* A 4 x 4 transpose in every quarter. Quarter k of vector r is row 4 k + r. */
#if LANES == 4
#define QUARTERS(operation) _mm_##operation
typedef __m128i quarters;
#elif LANES == 8
#define QUARTERS(operation) _mm256_##operation
typedef __m256i quarters;
#else
#define QUARTERS(operation) _mm512_##operation
typedef __m512i quarters;
#endif
LANE_FN void transpose4(quarters r0, quarters r1, quarters r2, quarters r3, vi* a, vi* b, vi* c,
                        vi* d) {
  const quarters low01 = QUARTERS(unpacklo_epi32(r0, r1)), low23 = QUARTERS(unpacklo_epi32(r2, r3));
  const quarters high01 = QUARTERS(unpackhi_epi32(r0, r1)),
                 high23 = QUARTERS(unpackhi_epi32(r2, r3));
  *a = (vi)QUARTERS(unpacklo_epi64(low01, low23)), *b = (vi)QUARTERS(unpackhi_epi64(low01, low23));
  *c = (vi)QUARTERS(unpacklo_epi64(high01, high23)),
  *d = (vi)QUARTERS(unpackhi_epi64(high01, high23));
}
#undef QUARTERS
LANE_FN __m128i load_quarter(const char* p) { return _mm_loadu_si128((const __m128i*)p); }
LANE_FN quarters load_quarters(const char* p, int64_t bytes) { /* rows 0, 4, 8, 12 from p on */
#if LANES == 4
  (void)bytes;
  return load_quarter(p);
#elif LANES == 8
  return _mm256_inserti128_si256(_mm256_castsi128_si256(load_quarter(p)),
                                 load_quarter(p + 4 * bytes), 1);
#else
  const __m512i first = _mm512_castsi128_si512(load_quarter(p));
  const __m512i two = _mm512_inserti32x4(first, load_quarter(p + 4 * bytes), 1);
  const __m512i three = _mm512_inserti32x4(two, load_quarter(p + 8 * bytes), 2);
  return _mm512_inserti32x4(three, load_quarter(p + 12 * bytes), 3);
#endif
}
LANE_FN void store_quarter(char* p, __m128i a) { _mm_storeu_si128((__m128i*)p, a); }
LANE_FN void store_quarters(char* p, int64_t bytes, vi a) {
#if LANES == 4
  (void)bytes;
  store_quarter(p, (__m128i)a);
#elif LANES == 8
  store_quarter(p, _mm256_castsi256_si128((__m256i)a));
  store_quarter(p + 4 * bytes, _mm256_extracti128_si256((__m256i)a, 1));
#else
  store_quarter(p, _mm512_castsi512_si128((__m512i)a));
  store_quarter(p + 4 * bytes, _mm512_extracti32x4_epi32((__m512i)a, 1));
  store_quarter(p + 8 * bytes, _mm512_extracti32x4_epi32((__m512i)a, 2));
  store_quarter(p + 12 * bytes, _mm512_extracti32x4_epi32((__m512i)a, 3));
#endif
}
LANE_FN void load_columns4i(const char* p, int32_t width, vi* a, vi* b, vi* c, vi* d) {
  const int64_t bytes = 4 * (int64_t)width;
  transpose4(load_quarters(p, bytes), load_quarters(p + bytes, bytes),
             load_quarters(p + 2 * bytes, bytes), load_quarters(p + 3 * bytes, bytes), a, b, c, d);
}
LANE_FN void store_columns4i(char* p, int32_t width, vi a, vi b, vi c, vi d) {
  const int64_t bytes = 4 * (int64_t)width;
  vi r0, r1, r2, r3;
  transpose4((quarters)a, (quarters)b, (quarters)c, (quarters)d, &r0, &r1, &r2, &r3);
  store_quarters(p, bytes, r0), store_quarters(p + bytes, bytes, r1);
  store_quarters(p + 2 * bytes, bytes, r2), store_quarters(p + 3 * bytes, bytes, r3);
}
#else
LANE_FN void load_columns4i(const char* p, int32_t width, vi* a, vi* b, vi* c, vi* d) {
  *a = load_columni(p, width), *b = load_columni(p + 4, width);
  *c = load_columni(p + 8, width), *d = load_columni(p + 12, width);
}
LANE_FN void store_columns4i(char* p, int32_t width, vi a, vi b, vi c, vi d) {
  store_columni(p, width, a), store_columni(p + 4, width, b);
  store_columni(p + 8, width, c), store_columni(p + 12, width, d);
}
#endif
LANE_FN void load4i(const char* p, vi* a, vi* b, vi* c, vi* d) { load_columns4i(p, 4, a, b, c, d); }
LANE_FN void store2i(char* p, vi a, vi b) { store_columni(p, 2, a), store_columni(p + 4, 2, b); }

/* Stores rows of nine and of twelve words, which elements write for three and for four corners. */
#if LANES == 16
/* Nine columns are three blocks of three columns, packed by pack3. Word w of the row-major store is
 * word 3 (w / 9) + w % 3 of block w % 9 / 3. nine_over() inserts the words of part z. */
#define LANES_NINE(w) (3 * ((w) / 9) + (w) % 3)
#define LANES_NINE_BLOCK(w) ((w) % 9 / 3)
#define LANES_NINE_WORD(l) \
  (LANES_NINE(16 * j + (l)) % 16 + (LANES_NINE_BLOCK(16 * j + (l)) == 1 ? 16 : 0))
LANE_FN __mmask16 nine_from(int j, int block, int z) {
  unsigned mask = 0;
  for (int l = 0; l < 16; ++l)
    mask |= (unsigned)(LANES_NINE_BLOCK(16 * j + l) == block && LANES_NINE(16 * j + l) / 16 == z)
            << l;
  return (__mmask16)mask;
}
LANE_FN __m512i nine_over(__m512i words, int j, const rows3* blocks, int block, int z) {
  const vi word = {LANE_LIST(LANES_NINE_WORD)};
  return _mm512_mask_permutexvar_epi32(words, nine_from(j, block, z), (__m512i)word,
                                       (__m512i)blocks[block].part[z]);
}
LANE_FN __m512i nine(int j, const rows3* blocks, int z) {
  const vi word = {LANE_LIST(LANES_NINE_WORD)};
  const __m512i two = _mm512_permutex2var_epi32((__m512i)blocks[0].part[z], (__m512i)word,
                                                (__m512i)blocks[1].part[z]);
  return nine_over(two, j, blocks, 2, z);
}
LANE_FN void store9i(char* p, vi a, vi b, vi c, vi d, vi e, vi f, vi g, vi h, vi i) {
  const rows3 blocks[3] = {pack3(a, b, c), pack3(d, e, f), pack3(g, h, i)};
  store_lanes(p, (vi)nine(0, blocks, 0)), store_lanes(p + 64, (vi)nine(1, blocks, 0));
  store_lanes(p + 128, (vi)nine_over(nine(2, blocks, 0), 2, blocks, 0, 1));
  store_lanes(p + 192,
              (vi)nine_over(nine_over(nine(3, blocks, 1), 3, blocks, 1, 0), 3, blocks, 2, 0));
  store_lanes(p + 256, (vi)nine(4, blocks, 1));
  store_lanes(p + 320,
              (vi)nine_over(nine_over(nine(5, blocks, 1), 5, blocks, 0, 2), 5, blocks, 1, 2));
  store_lanes(p + 384, (vi)nine_over(nine(6, blocks, 2), 6, blocks, 2, 1));
  store_lanes(p + 448, (vi)nine(7, blocks, 2)), store_lanes(p + 512, (vi)nine(8, blocks, 2));
}
/* Stores quarter k of a, b, c and d side by side, for each k, at every third vector of the rows. */
LANE_FN void store_quarter_rows(char* p, vi a, vi b, vi c, vi d) {
  const __m512i ab0 = _mm512_shuffle_i32x4((__m512i)a, (__m512i)b, 0x44),
                ab2 = _mm512_shuffle_i32x4((__m512i)a, (__m512i)b, 0xEE),
                cd0 = _mm512_shuffle_i32x4((__m512i)c, (__m512i)d, 0x44),
                cd2 = _mm512_shuffle_i32x4((__m512i)c, (__m512i)d, 0xEE);
  store_lanes(p, (vi)_mm512_shuffle_i32x4(ab0, cd0, 0x88));
  store_lanes(p + 192, (vi)_mm512_shuffle_i32x4(ab0, cd0, 0xDD));
  store_lanes(p + 384, (vi)_mm512_shuffle_i32x4(ab2, cd2, 0x88));
  store_lanes(p + 576, (vi)_mm512_shuffle_i32x4(ab2, cd2, 0xDD));
}
LANE_FN void store12i(char* p, vi a, vi b, vi c, vi d, vi e, vi f, vi g, vi h, vi i, vi j, vi k,
                      vi l) {
  vi x[4], y[4], z[4]; /* quarter q of vector r: row 4 q + r */
  transpose4((quarters)a, (quarters)b, (quarters)c, (quarters)d, &x[0], &x[1], &x[2], &x[3]);
  transpose4((quarters)e, (quarters)f, (quarters)g, (quarters)h, &y[0], &y[1], &y[2], &y[3]);
  transpose4((quarters)i, (quarters)j, (quarters)k, (quarters)l, &z[0], &z[1], &z[2], &z[3]);
  store_quarter_rows(p, x[0], y[0], z[0], x[1]);
  store_quarter_rows(p + 64, y[1], z[1], x[2], y[2]);
  store_quarter_rows(p + 128, z[2], x[3], y[3], z[3]);
}
#else
LANE_FN void store9i(char* p, vi a, vi b, vi c, vi d, vi e, vi f, vi g, vi h, vi i) {
  store_columns4i(p, 9, a, b, c, d), store_columns4i(p + 16, 9, e, f, g, h);
  store_columni(p + 32, 9, i);
}
LANE_FN void store12i(char* p, vi a, vi b, vi c, vi d, vi e, vi f, vi g, vi h, vi i, vi j, vi k,
                      vi l) {
  store_columns4i(p, 12, a, b, c, d), store_columns4i(p + 16, 12, e, f, g, h);
  store_columns4i(p + 32, 12, i, j, k, l);
}
#endif
/* Sets a group of rows of `words` words to zero. */
LANE_FN void store_zeros(char* p, int32_t words) {
  vi zero = splati(0);
  __asm__("" : LANES_IN_REGISTER(zero)); /* otherwise compilers fill the memory word by word */
  for (int32_t k = 0; k < words; ++k) store_lanes(p + 4 * LANES * k, zero);
}
LANE_FN void store9f(char* p, vf a, vf b, vf c, vf d, vf e, vf f, vf g, vf h, vf i) {
  store9i(p, (vi)a, (vi)b, (vi)c, (vi)d, (vi)e, (vi)f, (vi)g, (vi)h, (vi)i);
}
LANE_FN void store12f(char* p, vf a, vf b, vf c, vf d, vf e, vf f, vf g, vf h, vf i, vf j, vf k,
                      vf l) {
  store12i(p, (vi)a, (vi)b, (vi)c, (vi)d, (vi)e, (vi)f, (vi)g, (vi)h, (vi)i, (vi)j, (vi)k, (vi)l);
}
LANE_FN void store4i(char* p, vi a, vi b, vi c, vi d) { store_columns4i(p, 4, a, b, c, d); }

LANE_FN vf load_columnf(const char* p, int32_t width) { return (vf)load_columni(p, width); }
LANE_FN void load2f(const char* p, vf* a, vf* b) { load2i(p, (vi*)a, (vi*)b); }
LANE_FN void load3f(const char* p, vf* a, vf* b, vf* c) { load3i(p, (vi*)a, (vi*)b, (vi*)c); }
LANE_FN void load4f(const char* p, vf* a, vf* b, vf* c, vf* d) {
  load4i(p, (vi*)a, (vi*)b, (vi*)c, (vi*)d);
}
LANE_FN void load_columns4f(const char* p, int32_t width, vf* a, vf* b, vf* c, vf* d) {
  load_columns4i(p, width, (vi*)a, (vi*)b, (vi*)c, (vi*)d);
}
LANE_FN void store_columnf(char* p, int32_t width, vf a) { store_columni(p, width, (vi)a); }
LANE_FN void store2f(char* p, vf a, vf b) { store2i(p, (vi)a, (vi)b); }
LANE_FN void store3f(char* p, vf a, vf b, vf c) { store3i(p, (vi)a, (vi)b, (vi)c); }

/* Three columns that the primal of a scan keeps for its adjoint, column by column in `near`. take3f
 * reads them at near + at, or, if `near` is null, from the group of rows at `rows`. */
LANE_FN void keep3f(char* near, vf a, vf b, vf c) {
  store_lanes(near, (vi)a), store_lanes(near + 4 * LANES, (vi)b);
  store_lanes(near + 8 * LANES, (vi)c);
}
LANE_FN void take3f(const char* rows, const char* near, int64_t at, vf* a, vf* b, vf* c) {
  if (near == NULL) {
    load3f(rows, a, b, c);
    return;
  }
  near += at;
  *a = (vf)load_lanes(near), *b = (vf)load_lanes(near + 4 * LANES);
  *c = (vf)load_lanes(near + 8 * LANES);
}
/* Stores three columns. If `streams`, the stores bypass the caches. */
LANE_FN void put3f(char* rows, int streams, vf a, vf b, vf c) {
#if LANES == 16
  const rows3 packed = pack3((vi)a, (vi)b, (vi)c);
  if (streams)
    for (int k = 0; k < 3; ++k)
      _mm512_stream_si512((__m512i*)(rows + 64 * k), (__m512i)packed.part[k]);
  else
    store_rows3(rows, &packed);
#else
  (void)streams;
  store3f(rows, a, b, c);
#endif
}
LANE_FN void store4f(char* p, vf a, vf b, vf c, vf d) { store4i(p, (vi)a, (vi)b, (vi)c, (vi)d); }
LANE_FN void store_columns4f(char* p, int32_t width, vf a, vf b, vf c, vf d) {
  store_columns4i(p, width, (vi)a, (vi)b, (vi)c, (vi)d);
}

#include "lanes_gather.h"
