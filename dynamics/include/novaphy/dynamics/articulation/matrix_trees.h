// The first include of kernels that factor mass matrices only (factor.h): functions of articulated
// bodies made the kernels of contacts fail on GPUs. Their callers refuse longer trees.
#pragma once

#ifdef NOVAPHY_KERNEL
#define NOVAPHY_MATRIX_TREES
#endif
