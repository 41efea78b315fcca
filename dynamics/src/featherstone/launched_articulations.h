// Steps of articulations as launches (core/device_kernel.h), on devices. Without contacts and dry
// friction one with a thread for each articulation, which does what it does on the cpu
// (articulation_kernels.h); else those of launched_contacts.h.
#pragma once

#include <memory>

#include "actuators.h"
#include "launched_contacts.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/sim/unread_materials.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

class LaunchedArticulations {
 public:
  // Errors as Articulations.
  explicit LaunchedArticulations(const Model& model);

  // ErrorKind::NotImplemented as Articulations::check_values and UnreadMaterials. `in_use`: the use
  // of this memory, which a recording takes. Contacts are those of pgs.
  void step(const SimState& in, const SimState& out, const Control* control,
            const Contacts* contacts, const FeatherstoneOptions& options, float dt,
            const std::shared_ptr<ExclusiveUse>& in_use);
  // These wait for the last step that ran. ErrorKind::Runtime, naming the dof that failed;
  // ErrorKind::Index: a contact of shapes that are not there, or of two worlds.
  void check() const;
  int32_t sweeps() const { return contacts_.sweeps(); }
  float residual() const { return contacts_.residual(); }
  void forget_impulses() { contacts_.forget_impulses(); }

 private:
  const Model& model_;
  Articulations articulations_;
  LaunchedContacts contacts_;
  ActuatedStep actuated_;
  UnreadMaterials materials_;
  DeviceArray<int32_t> status_;
  DeviceArray<float> qdd_, branch_, workspace_;
};

}  // namespace novaphy
