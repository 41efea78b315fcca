// The scalar functions of <novaphy/math/scalar.h> for device code, which has no library header. The
// formulas themselves are the same files.
namespace novaphy::math {
inline float min(float a, float b) { return umin(a, b); }
inline float max(float a, float b) { return umax(a, b); }
inline float abs(float a) { return uabs(a); }
inline float sign(float a) { return usign(a); }
inline float sqrt(float a) { return usqrt(a); }
inline float floor(float a) { return ufloor(a); }
inline float fma(float a, float b, float c) { return ufma(a, b, c); }
inline float select(bool c, float a, float b) { return c ? a : b; }
inline bool select(bool c, bool a, bool b) { return c ? a : b; }
inline bool both(bool a, bool b) { return a && b; }
inline bool either(bool a, bool b) { return a || b; }
inline bool negate(bool a) { return !a; }
inline float detach(float a) { return a; }
inline float with_derivative(float y, float, float) { return y; }
template <class T>
T clamp(const T& x, const T& lo, const T& hi) {
  return min(max(x, lo), hi);
}
}  // namespace novaphy::math
