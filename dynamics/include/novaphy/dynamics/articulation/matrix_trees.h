// Kernels that support only mass matrices (factor.h) include this header first. The header leaves
// out the articulated-body algorithm, with which the contact kernels fail on GPUs. The callers of
// such kernels reject trees that need this algorithm.
#pragma once

#ifdef NOVAPHY_KERNEL
#define NOVAPHY_MATRIX_TREES
#endif
