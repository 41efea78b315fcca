// Denglin's devices (docs/guide/denglin.md). Little is known about them, so everything comes from
// generic.cuh: one thread per row, no warp intrinsics and no assembler.
//
// Contracted sums would have other bits. This pragma forbids them if the compiler has no option.
#pragma clang fp contract(off)
#define VENDOR_SOURCE_BEGIN _Pragma("clang force_cuda_host_device begin")
#define VENDOR_SOURCE_END _Pragma("clang force_cuda_host_device end")
