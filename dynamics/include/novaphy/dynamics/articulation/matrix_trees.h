// The first include of kernels that support mass matrices only (factor.h). With the functions of
// articulated bodies, the contact kernels fail on GPUs. The callers of such kernels reject longer
// trees.
#pragma once

#ifdef NOVAPHY_KERNEL
#define NOVAPHY_MATRIX_TREES
#endif
