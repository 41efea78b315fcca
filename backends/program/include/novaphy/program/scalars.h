/* The functions of emitted text (emit.h) that are plain arithmetic on scalars, for C compilers and
 * device compilers. Needs no other header. The including file defines the sized integers, LANE_FN,
 * and ubits_f, which reads bits as a float. Functions for which processors have special
 * instructions (roots, fused products, floor, conversions) are defined elsewhere. */
LANE_FN int32_t uparam_i(uint64_t word) { return (int32_t)(uint32_t)word; }
LANE_FN float uparam_f(uint64_t word) { return ubits_f(uparam_i(word)); }

LANE_FN float usign(float a) { return a < 0.0f ? -1.0f : 1.0f; }
LANE_FN float umin(float a, float b) { return a <= b ? a : b; }
LANE_FN float umax(float a, float b) { return a >= b ? a : b; }
/* Returns a bound: no x up to the result has a square root above c. */
LANE_FN float square_below(float c) {
  const float below = c * c * 0.999f, most = 3.40282347e38f;
  return !(c >= 1e-18f) ? ubits_f((int32_t)0xFF800000u) : below < most ? below : most;
}
/* Computed with unsigned integers, because some compilers have no option that makes signed integers
 * wrap. */
LANE_FN int32_t uiadd(int32_t a, int32_t b) { return (int32_t)((uint32_t)a + (uint32_t)b); }
LANE_FN int32_t uisub(int32_t a, int32_t b) { return (int32_t)((uint32_t)a - (uint32_t)b); }
LANE_FN int32_t uimul(int32_t a, int32_t b) { return (int32_t)((uint32_t)a * (uint32_t)b); }
LANE_FN int32_t uidiv(int32_t a, int32_t b) {
  if (b == 0) return 0;
  if (b == -1) return (int32_t)(0u - (uint32_t)a);
  return a / b;
}
LANE_FN int32_t uimod(int32_t a, int32_t b) { return b == 0 || b == -1 ? 0 : a % b; }
LANE_FN int32_t uimin(int32_t a, int32_t b) { return a <= b ? a : b; }
LANE_FN int32_t uimax(int32_t a, int32_t b) { return a >= b ? a : b; }
LANE_FN int32_t uishl(int32_t a, int32_t b) { return (int32_t)((uint32_t)a << (b & 31)); }
LANE_FN int32_t uishr(int32_t a, int32_t b) { return a >> (b & 31); }
LANE_FN int32_t uiushr(int32_t a, int32_t b) { return (int32_t)((uint32_t)a >> (b & 31)); }
LANE_FN int ult(float a, float b) { return a < b; }
LANE_FN int ule(float a, float b) { return a <= b; }
LANE_FN int ueq(float a, float b) { return a == b; }
LANE_FN int une(float a, float b) { return a != b; }
LANE_FN int uilt(int32_t a, int32_t b) { return a < b; }
LANE_FN int uile(int32_t a, int32_t b) { return a <= b; }
LANE_FN int uieq(int32_t a, int32_t b) { return a == b; }
LANE_FN int uine(int32_t a, int32_t b) { return a != b; }
LANE_FN int uand(int a, int b) { return a & b; }
LANE_FN int uor(int a, int b) { return a | b; }
LANE_FN int unot(int a) { return !a; }
LANE_FN float uselectf(int c, float a, float b) { return c ? a : b; }
LANE_FN int32_t uselecti(int c, int32_t a, int32_t b) { return c ? a : b; }
LANE_FN int uselectb(int c, int a, int b) { return c ? a : b; }
