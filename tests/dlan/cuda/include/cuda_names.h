// Declarations for device code that the headers of a CUDA compiler would provide, for clang without
// a CUDA SDK (-nocudainc -nocudalib). Also declares the run-time functions that clang needs for
// host stubs.
#pragma once

#define __host__ __attribute__((host))
#define __device__ __attribute__((device))
#define __global__ __attribute__((global))
#define __shared__ __attribute__((shared))
#define __launch_bounds__(...) __attribute__((launch_bounds(__VA_ARGS__)))
#define __forceinline__ __inline__ __attribute__((always_inline))
#define __noinline__ __attribute__((noinline))

#include <__clang_cuda_builtin_vars.h>

struct dim3 {
  unsigned x, y, z;
};
using cudaError_t = int;
using cudaStream_t = struct cudaStream*;
extern "C" cudaError_t cudaLaunchKernel(const void*, dim3, dim3, void**, __SIZE_TYPE__, cudaStream_t);
extern "C" unsigned cudaConfigureCall(dim3, dim3, __SIZE_TYPE__ = 0, cudaStream_t = nullptr);

#define CUDA_NAME static __inline__ __device__ __attribute__((always_inline))
template <class T>
CUDA_NAME T __ldg(const T* p) {
  return *p;
}
CUDA_NAME float __int_as_float(int a) { return __builtin_bit_cast(float, a); }
CUDA_NAME int __float_as_int(float a) { return __builtin_bit_cast(int, a); }
CUDA_NAME float __fmaf_rn(float a, float b, float c) { return __nvvm_fma_rn_f(a, b, c); }
CUDA_NAME float __fsqrt_rn(float a) { return __nvvm_sqrt_rn_f(a); }
CUDA_NAME float floorf(float a) { return __nvvm_floor_f(a); }
CUDA_NAME int __float2int_rz(float a) { return __nvvm_f2i_rz(a); }
CUDA_NAME float __int2float_rn(int a) { return __nvvm_i2f_rn(a); }
CUDA_NAME void __threadfence() { __nvvm_membar_gl(); }
CUDA_NAME void __threadfence_system() { __nvvm_membar_sys(); }
template <class T>
CUDA_NAME T atomicAdd(T* at, T value) {
  return __atomic_fetch_add(at, value, __ATOMIC_RELAXED);
}
template <class T>
CUDA_NAME T atomicExch(T* at, T value) {
  return __atomic_exchange_n(at, value, __ATOMIC_RELAXED);
}
#undef CUDA_NAME
