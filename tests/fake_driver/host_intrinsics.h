// The intrinsics that device text expects of its compiler, for a host on which one thread runs at a
// time. Include this file inside the namespace of the text, after the standard headers of the text.
template <class T>
T __ldg(const T* p) {
  return *p;
}
float __int_as_float(int a) {
  float f;
  std::memcpy(&f, &a, 4);
  return f;
}
int __float_as_int(float f) {
  int a;
  std::memcpy(&a, &f, 4);
  return a;
}
float __fsqrt_rn(float a) { return std::sqrt(a); }
float __fmaf_rn(float a, float b, float c) { return std::fma(a, b, c); }
int __float2int_rz(float a) { return static_cast<int>(a); }
float __int2float_rn(int a) { return static_cast<float>(a); }
float floorf(float a) { return std::floor(a); }
template <class T>
T atomicAdd(T* at, T value) {
  return std::exchange(*at, *at + value);
}
template <class T>
T atomicExch(T* at, T value) {
  return std::exchange(*at, value);
}
void __threadfence() {}
void __threadfence_system() {}

#undef INT32_MAX
#undef INT32_MIN
#define __device__
#define __global__
#define __forceinline__ inline
#define __noinline__
#define __launch_bounds__(...)
#define __grid_constant__
