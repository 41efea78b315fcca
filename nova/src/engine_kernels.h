// Internal: each file with kernels adds them to the list of the engine's kernels.
#pragma once

#include "novaphy/nova/registry.h"

namespace nova::detail {

using EngineKernels = std::vector<EngineKernel>;

void add_op_kernels(EngineKernels& list);       // ops.cpp
void add_sum_kernels(EngineKernels& list);      // ops_sums.cpp
void add_row_kernels(EngineKernels& list);      // ops_rows.cpp
void add_matmul_kernels(EngineKernels& list);   // ops_matmul.cpp
void add_vector_kernels(EngineKernels& list);   // ops_vectors.cpp
void add_network_kernels(EngineKernels& list);  // ops_networks.cpp
void add_optim_kernels(EngineKernels& list);    // optim.cpp; calls the next three
void add_sgd_kernels(EngineKernels& list);      // optim_sgd.cpp
void add_adam_kernels(EngineKernels& list);     // optim_adam.cpp
void add_clip_kernels(EngineKernels& list);     // optim_clip.cpp
void add_tape_kernels(EngineKernels& list);     // tape_backward.cpp
void add_tensor_kernels(EngineKernels& list);   // tensor.cpp

}  // namespace nova::detail
