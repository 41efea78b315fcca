// The kernels that the engine itself defines, with the gradients that are built ahead for them:
// what the build's kernel generator compiles into the CPU plugin. A kernel that is not listed
// works, interpreted.
#pragma once

#include <string>
#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/nova/kernel.h"

namespace nova {

struct EngineKernel {
  Kernel kernel;
  std::vector<AdjointMask> gradients;  // of these, the adjoints are built ahead too
};

// The kernels of this library. novaphy::diff::engine_kernels() lists those of the operators.
NOVAPHY_NOVA_API std::vector<EngineKernel> engine_kernels();

// The Programs of a list, every one once, in the order of their hashes.
NOVAPHY_NOVA_API std::vector<ir::Program> programs_of(const std::vector<EngineKernel>& kernels);

// The kernel, with the sets of gradients that are built ahead. A backward that asks for a part of
// one takes its adjoint, with zeros for the gradients of outputs that have none, and memory that
// nobody reads for what nobody asked for. So the sign of a zero may differ from that of an adjoint
// of exactly what is asked.
NOVAPHY_NOVA_API Kernel with_gradients(Kernel kernel, std::vector<AdjointMask> gradients);
// Two sets, with the gradients of all outputs given: of `state`, stored, which the steps of a
// rollout ask for; and of every float source, gated, for whatever else is asked.
NOVAPHY_NOVA_API std::vector<AdjointMask> gradient_sets(const Kernel& kernel,
                                                        const std::vector<std::string>& state);
// The second of them alone.
NOVAPHY_NOVA_API std::vector<AdjointMask> one_gradient_set(const Kernel& kernel);
// The kernel with one_gradient_set(kernel), and with gradient_sets(kernel, state).
NOVAPHY_NOVA_API Kernel with_one_gradient_set(const Kernel& kernel);
NOVAPHY_NOVA_API Kernel with_gradient_sets(const Kernel& kernel,
                                           const std::vector<std::string>& state);

// A mask from the names of sources and outputs. `accumulate`: those of `wrt` whose gradient is
// added to.
NOVAPHY_NOVA_API AdjointMask gradient_mask(const Kernel& kernel,
                                           const std::vector<std::string>& wrt,
                                           const std::vector<std::string>& accumulate,
                                           const std::vector<std::string>& seeded);

}  // namespace nova
