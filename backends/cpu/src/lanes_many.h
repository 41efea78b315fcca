/* Vectors of several lanes: values and arithmetic. An operation that the vector extensions lack, or
 * for which compilers do not find the instruction, is written per instruction set, or else lane by
 * lane. */
#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

typedef float vf __attribute__((vector_size(4 * LANES)));
typedef int32_t vi __attribute__((vector_size(4 * LANES)));
typedef uint32_t vu __attribute__((vector_size(4 * LANES)));
typedef vi vi_unaligned __attribute__((aligned(4), may_alias));

#if LANES == 4
#define LANE_LIST(f) f(0), f(1), f(2), f(3)
#elif LANES == 8
#define LANE_LIST(f) f(0), f(1), f(2), f(3), f(4), f(5), f(6), f(7)
#else
#define LANE_LIST(f)                                                                             \
  f(0), f(1), f(2), f(3), f(4), f(5), f(6), f(7), f(8), f(9), f(10), f(11), f(12), f(13), f(14), \
      f(15)
#endif
#define LANE_NUMBER(l) l

LANE_FN vf splatf(float a) {
#define LANE_A(l) a
  return (vf){LANE_LIST(LANE_A)};
}
LANE_FN vi splati(int32_t a) { return (vi){LANE_LIST(LANE_A)}; }
LANE_FN vi lane_numbers(void) { return (vi){LANE_LIST(LANE_NUMBER)}; }
LANE_FN vi index_lanes(int64_t i) { return lane_numbers() + (int32_t)i; }
LANE_FN vi vf_bits(vf a) { return (vi)a; }
LANE_FN vf vbits_f(vi a) { return (vf)a; }

/* A truth value per lane: one bit where the processor has mask registers, otherwise a word with all
 * bits 1 or all 0. */
#if LANES == 16
typedef __mmask16 vb;
LANE_FN vb splatb(int a) { return (vb)(a ? 0xFFFF : 0); }
LANE_FN int any(vb a) { return a != 0; }
LANE_FN int all(vb a) { return a == 0xFFFF; }
LANE_FN int lane_of(vb a, int l) { return (a >> l) & 1; }
LANE_FN vb vand(vb a, vb b) { return (vb)(a & b); }
LANE_FN vb vor(vb a, vb b) { return (vb)(a | b); }
LANE_FN vb vnot(vb a) { return (vb)~a; }
LANE_FN vb vselectb(vb c, vb a, vb b) { return (vb)((c & a) | (~c & b)); }
LANE_FN vf vselectf(vb c, vf a, vf b) { return (vf)_mm512_mask_blend_ps(c, (__m512)b, (__m512)a); }
LANE_FN vi vselecti(vb c, vi a, vi b) {
  return (vi)_mm512_mask_blend_epi32(c, (__m512i)b, (__m512i)a);
}
#define LANES_COMPARE(name, T, expression) \
  LANE_FN vb name(T a, T b) { return expression; }
#define LANES_FLOATS(o) _mm512_cmp_ps_mask((__m512)a, (__m512)b, o)
#define LANES_INTS(o) _mm512_cmp_epi32_mask((__m512i)a, (__m512i)b, o)
LANES_COMPARE(vlt, vf, LANES_FLOATS(_CMP_LT_OQ))
LANES_COMPARE(vle, vf, LANES_FLOATS(_CMP_LE_OQ))
LANES_COMPARE(veq, vf, LANES_FLOATS(_CMP_EQ_OQ))
LANES_COMPARE(vne, vf, LANES_FLOATS(_CMP_NEQ_UQ))
LANES_COMPARE(vge, vf, LANES_FLOATS(_CMP_GE_OQ))
LANES_COMPARE(vilt, vi, LANES_INTS(_MM_CMPINT_LT))
LANES_COMPARE(vile, vi, LANES_INTS(_MM_CMPINT_LE))
LANES_COMPARE(vieq, vi, LANES_INTS(_MM_CMPINT_EQ))
LANES_COMPARE(vine, vi, LANES_INTS(_MM_CMPINT_NE))
#else
typedef vi vb;
LANE_FN vb splatb(int a) { return splati(a ? -1 : 0); }
LANE_FN int lane_of(vb a, int l) { return a[l] != 0; }
LANE_FN vb vand(vb a, vb b) { return a & b; }
LANE_FN vb vor(vb a, vb b) { return a | b; }
LANE_FN vb vnot(vb a) { return ~a; }
LANE_FN vb vlt(vf a, vf b) { return (vb)(a < b); }
LANE_FN vb vle(vf a, vf b) { return (vb)(a <= b); }
LANE_FN vb veq(vf a, vf b) { return (vb)(a == b); }
LANE_FN vb vne(vf a, vf b) { return (vb)(a != b); }
LANE_FN vb vge(vf a, vf b) { return (vb)(a >= b); }
LANE_FN vb vilt(vi a, vi b) { return (vb)(a < b); }
LANE_FN vb vile(vi a, vi b) { return (vb)(a <= b); }
LANE_FN vb vieq(vi a, vi b) { return (vb)(a == b); }
LANE_FN vb vine(vi a, vi b) { return (vb)(a != b); }
#if LANES == 8
LANE_FN int any(vb a) { return !_mm256_testz_si256((__m256i)a, (__m256i)a); }
LANE_FN int all(vb a) { return _mm256_movemask_ps((__m256)a) == 0xFF; }
LANE_FN vi vselecti(vb c, vi a, vi b) {
  return (vi)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)c);
}
#else
#if defined(__x86_64__)
LANE_FN int any(vb a) { return _mm_movemask_ps((__m128)a) != 0; }
LANE_FN int all(vb a) { return _mm_movemask_ps((__m128)a) == 0xF; }
#elif defined(__aarch64__)
LANE_FN int any(vb a) { return vmaxvq_u32((uint32x4_t)a) != 0; }
LANE_FN int all(vb a) { return vminvq_u32((uint32x4_t)a) != 0; }
#else
LANE_FN int any(vb a) { return (a[0] | a[1] | a[2] | a[3]) != 0; }
LANE_FN int all(vb a) { return (a[0] & a[1] & a[2] & a[3]) != 0; }
#endif
LANE_FN vi vselecti(vb c, vi a, vi b) { return (c & a) | (~c & b); }
#endif
LANE_FN vf vselectf(vb c, vf a, vf b) { return (vf)vselecti(c, (vi)a, (vi)b); }
LANE_FN vb vselectb(vb c, vb a, vb b) { return (vb)vselecti(c, (vi)a, (vi)b); }
#endif

LANE_FN vf vabs(vf a) { return (vf)((vi)a & INT32_MAX); }
LANE_FN vf vsign(vf a) {
  return (vf)(((vi)vselectf(vlt(a, splatf(0.0f)), splatf(-1.0f), splatf(1.0f))));
}
LANE_FN vf vmin(vf a, vf b) { return vselectf(vle(a, b), a, b); }
LANE_FN vf vmax(vf a, vf b) { return vselectf(vge(a, b), a, b); }
LANE_FN vi vimin(vi a, vi b) { return vselecti(vile(a, b), a, b); }
LANE_FN vi vimax(vi a, vi b) { return vselecti(vile(b, a), a, b); }
LANE_FN vi vishl(vi a, vi b) { return (vi)((vu)a << (vu)(b & 31)); }
LANE_FN vi vishr(vi a, vi b) { return a >> (b & 31); }
LANE_FN vi viushr(vi a, vi b) { return (vi)((vu)a >> (vu)(b & 31)); }
LANE_FN vf vi_to_f(vi a) { return __builtin_convertvector(a, vf); }

#if LANES == 16
#define LANES_IN_REGISTER(a) "+v"(a)
#elif defined(__x86_64__)
#define LANES_IN_REGISTER(a) "+x"(a)
#elif defined(__aarch64__)
#define LANES_IN_REGISTER(a) "+w"(a)
#else
#define LANES_IN_REGISTER(a) "+m"(a)
#endif

/* The processor's conversion is only used in range, because the required result out of range
 * differs. */
LANE_FN vi vf_to_i(vf a) {
  const vb fits = vand(vge(a, splatf(-2147483648.0f)), vlt(a, splatf(2147483648.0f)));
  vi inside = __builtin_convertvector(vselectf(fits, a, splatf(0.0f)), vi);
  __asm__("" : LANES_IN_REGISTER(inside)); /* see uf_to_i */
  const vi outside = vselecti(vlt(splatf(0.0f), a), splati(INT32_MAX),
                              vselecti(vlt(a, splatf(0.0f)), splati(INT32_MIN), splati(0)));
  return vselecti(fits, inside, outside);
}

#define LANES_ONE_BY_ONE(name, expression)             \
  LANE_FN vi name(vi a, vi b) {                        \
    vi d;                                              \
    for (int l = 0; l < LANES; ++l) d[l] = expression; \
    return d;                                          \
  }
LANES_ONE_BY_ONE(vidiv, uidiv(a[l], b[l]))
LANES_ONE_BY_ONE(vimod, uimod(a[l], b[l]))

#if LANES == 16
LANE_FN vf vsqrt(vf a) { return (vf)_mm512_sqrt_ps((__m512)a); }
LANE_FN vf vfma(vf a, vf b, vf c) { return (vf)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c); }
LANE_FN vf vfloor(vf a) { return (vf)_mm512_roundscale_ps((__m512)a, 0x09); }
#elif LANES == 8
LANE_FN vf vsqrt(vf a) { return (vf)_mm256_sqrt_ps((__m256)a); }
LANE_FN vf vfma(vf a, vf b, vf c) { return (vf)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c); }
LANE_FN vf vfloor(vf a) { return (vf)_mm256_floor_ps((__m256)a); }
#elif defined(__aarch64__)
LANE_FN vf vsqrt(vf a) { return (vf)vsqrtq_f32((float32x4_t)a); }
LANE_FN vf vfma(vf a, vf b, vf c) {
  return (vf)vfmaq_f32((float32x4_t)c, (float32x4_t)a, (float32x4_t)b);
}
LANE_FN vf vfloor(vf a) { return (vf)vrndmq_f32((float32x4_t)a); }
#else
#if defined(__x86_64__)
LANE_FN vf vsqrt(vf a) { return (vf)_mm_sqrt_ps((__m128)a); }
#else
LANE_FN vf vsqrt(vf a) {
  vf d;
  for (int l = 0; l < LANES; ++l) d[l] = usqrt(a[l]);
  return d;
}
#endif
LANE_FN vf vfma(vf a, vf b, vf c) {
  vf d;
  for (int l = 0; l < LANES; ++l) d[l] = ufma(a[l], b[l], c[l]);
  return d;
}
LANE_FN vf vfloor(vf a) {
  const vb small = vlt(vabs(a), splatf(8388608.0f));
  const vf t = vi_to_f(__builtin_convertvector(vselectf(small, a, splatf(0.0f)), vi));
  const vf down = vselectf(vlt(a, t), t - 1.0f, t);
  const vf signed_down = (vf)(((vi)down & INT32_MAX) | ((vi)a & INT32_MIN));
  return vselectf(small, signed_down, a);
}
#endif
