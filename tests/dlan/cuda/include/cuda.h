// clang reads the version of the toolkit from this file. The version is one whose launches clang
// supports.
#define CUDA_VERSION 11020
