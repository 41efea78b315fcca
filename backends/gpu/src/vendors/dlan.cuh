// Denglin's devices, of which little is known (docs/guide/denglin.md): all is generic.cuh's, with one
// thread per row, no warp intrinsics and no assembler.
//
// Contracted sums have other bits. Where the compiler takes no option against them, this asks.
#pragma clang fp contract(off)
#define VENDOR_SOURCE_BEGIN _Pragma("clang force_cuda_host_device begin")
#define VENDOR_SOURCE_END _Pragma("clang force_cuda_host_device end")
