// clang reads the version of a toolkit here: one whose launches it knows.
#define CUDA_VERSION 11020
