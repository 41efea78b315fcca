// The joints of a step: a wrench for each side of each joint, and which sides every body has, in
// the order of the joints, the parent's before the child's.
#pragma once

#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

struct JointAttachOptions {
  float ke, kd;  // SemiImplicitOptions::joint_attach_ke, _kd
};

struct HostJoints;

// `prepare` works on models of every device, the rest on the CPU.
class JointForces {
 public:
  // Refuses what penalty joints cannot hold: ErrorKind::NotImplemented names the array and the row.
  // `solver` starts the messages.
  static void check_covered(const Model& model, const char* solver);

  // check_covered again, where one of its arrays was written since, and joint_act, the control's or
  // the model's. In a capture a replay throws once one was that has no effect.
  void check_edits(const Model& model, const Control* control, const char* solver);
  // Finds the sides of every body where the joints were written since. ErrorKind::Value: a step
  // above stable_dt.
  void prepare(const Model& model, const JointAttachOptions& attach, float dt);
  // control null: the model's forces and targets.
  void evaluate(const Model& model, const SimState& state, const Control* control,
                const JointAttachOptions& attach);
  bool empty() const { return bodies_.empty(); }
  SpatialVectorf add(int64_t body, SpatialVectorf wrench) const;

 private:
  void find_sides(const HostJoints& joints, int32_t body_count);

  std::vector<ArrayStamp> covered_;
  ArrayStamp enabled_, mass_, inertia_, flags_;
  float stable_dt_ = 0.0f;       // s: above it the attachment of a joint diverges by itself
  int32_t unstable_joint_ = -1;  // that joint
  std::vector<int32_t> bodies_;  // of the two sides of every joint; -1: the world, or no force
  IndexRows sides_;
  std::vector<SpatialVectorf> wrenches_;
};

}  // namespace novaphy
