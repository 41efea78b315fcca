// Replaces <novaphy/math/scalar.h> in device code, where standard headers do not exist. The
// formulas themselves are the same files on host and device.
#ifdef __CUDACC_RTC__  // NVRTC lacks these builtins
template <class A, class B>
constexpr bool novaphy_is_same = false;
template <class A>
constexpr bool novaphy_is_same<A, A> = true;
#define __is_same(...) novaphy_is_same<__VA_ARGS__>
#define __builtin_inff() __builtin_bit_cast(float, 0x7f800000)
#define __builtin_nanf(text) __builtin_bit_cast(float, 0x7fc00000)
#endif
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
inline int32_t to_int(float a) { return uf_to_i(a); }
inline float to_real(int32_t a) { return ui_to_f(a); }
inline int32_t float_bits(float a) { return uf_bits(a); }
inline float bits_float(int32_t a) { return ubits_f(a); }
inline float detach(float a) { return a; }
inline float with_derivative(float y, float, float) { return y; }
template <class T>
T clamp(const T& x, const T& lo, const T& hi) {
  return min(max(x, lo), hi);
}
}  // namespace novaphy::math
