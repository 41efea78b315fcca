// Steps of articulations without contacts as launches (core/device_kernel.h), on devices: a thread
// for each articulation, which does what it does on the cpu (articulation_kernels.h).
#pragma once

#include <memory>

#include "novaphy/core/exclusive_use.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

class LaunchedArticulations {
 public:
  // Errors as Articulations.
  explicit LaunchedArticulations(const Model& model);

  // ErrorKind::NotImplemented as Articulations::check_values; dry friction of joints too. `in_use`:
  // the use of this memory, which a recording takes.
  void step(const SimState& in, const SimState& out, const Control* control,
            const FeatherstoneOptions& options, float dt,
            const std::shared_ptr<ExclusiveUse>& in_use);
  // Waits for the last step that ran. ErrorKind::Runtime, naming the dof that failed.
  void check() const;

 private:
  const Model& model_;
  Articulations articulations_;
  DeviceArray<int32_t> status_;
  DeviceArray<float> qdd_, branch_, workspace_;
  int64_t stride_;  // numbers of an articulation's workspace
};

}  // namespace novaphy
