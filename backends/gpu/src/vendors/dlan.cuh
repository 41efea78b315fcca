// Denglin's devices (docs/guide/denglin.md). Little is known about them, so all definitions are
// those of generic.cuh: one thread per row, no warp intrinsics and no assembler.
//
// Sums with contraction to fused multiply-adds would have other bits. The pragma forbids
// contraction if the compiler has no option for it.
#pragma clang fp contract(off)
#define VENDOR_SOURCE_BEGIN _Pragma("clang force_cuda_host_device begin")
#define VENDOR_SOURCE_END _Pragma("clang force_cuda_host_device end")
