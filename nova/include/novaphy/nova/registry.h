// The kernels that the engine defines, with the gradients whose adjoints are compiled ahead of
// time. The build's kernel generator compiles them into the CPU plugin. An unlisted kernel runs in
// the interpreter.
#pragma once

#include <string>
#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/nova/kernel.h"

namespace nova {

struct EngineKernel {
  Kernel kernel;
  std::vector<AdjointMask> gradients;  // sets of gradients whose adjoints are compiled too
};

// Returns the kernels of this library. novaphy::diff::engine_kernels() returns those of the
// operators.
NOVAPHY_NOVA_API std::vector<EngineKernel> engine_kernels();

// Returns the Programs of a list without duplicates, ordered by their hashes.
NOVAPHY_NOVA_API std::vector<ir::Program> programs_of(const std::vector<EngineKernel>& kernels);

// Returns the kernel with sets of gradients that are compiled ahead of time. A backward pass that
// needs a part of a set runs the adjoint of the set. Missing output gradients are zeros, and
// gradients that were not requested go to scratch memory. The sign of a zero may therefore differ
// from that of an adjoint of exactly the requested gradients.
NOVAPHY_NOVA_API Kernel with_gradients(Kernel kernel, std::vector<AdjointMask> gradients);
// Returns two sets of gradients, both for given gradients of all outputs. The first set stores the
// gradients of `state`, which the steps of a rollout need. The second set is gated
// (AdjointMask::gated) and has every float source, for all other requests.
NOVAPHY_NOVA_API std::vector<AdjointMask> gradient_sets(const Kernel& kernel,
                                                        const std::vector<std::string>& state);
// Returns only the gated set of gradient_sets.
NOVAPHY_NOVA_API std::vector<AdjointMask> one_gradient_set(const Kernel& kernel);
// Return the kernel with the sets of one_gradient_set or of gradient_sets.
NOVAPHY_NOVA_API Kernel with_one_gradient_set(const Kernel& kernel);
NOVAPHY_NOVA_API Kernel with_gradient_sets(const Kernel& kernel,
                                           const std::vector<std::string>& state);

// Makes a mask from the names of sources and outputs. The gradients of the sources in `accumulate`,
// a part of `wrt`, are added to the present values.
NOVAPHY_NOVA_API AdjointMask gradient_mask(const Kernel& kernel,
                                           const std::vector<std::string>& wrt,
                                           const std::vector<std::string>& accumulate,
                                           const std::vector<std::string>& seeded);

}  // namespace nova
