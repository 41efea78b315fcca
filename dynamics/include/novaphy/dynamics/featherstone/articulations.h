// Articulations: those of a model as trees (articulation/tree.h), for solvers and functions.
#pragma once

#include <string>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/articulation/tree.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// The joints of a model (joint_type, joint_parent, joint_child, articulation_start, ...) are read
// once, when it is made; everything else at every use.
class NOVAPHY_DYNAMICS_API Articulations {
 public:
  // Steps: also of kinematic bodies.
  enum class For { Functions, Steps };
  // `user` starts the messages. ErrorKind::NotImplemented: a joint that belongs to no articulation,
  // a DISTANCE joint, a kinematic body (of steps: one whose joint is not FREE or FIXED to the
  // world). ErrorKind::Value:
  // Model::check_structure.
  Articulations(const Model& model, const char* user, For purpose = For::Functions);

  int64_t count() const { return static_cast<int64_t>(rows_.rows()); }
  int32_t max_links() const { return max_links_; }
  int32_t max_dofs() const { return max_dofs_; }
  // These three on the model's device.
  // {count} rows of articulation/arguments.h.
  const DeviceArray<int32_t>& rows() const { return rows_; }
  const DeviceArray<int32_t>& links() const { return links_; }  // rows of articulation::Link
  const DeviceArray<int32_t>& dof_parent() const { return dof_parent_; }
  // Over the arrays of the model, which must live as long. On the cpu.
  articulation::Tree<float> tree(const Model& model, int64_t i) const;

  // ErrorKind::NotImplemented, naming the array: a value that would have no effect: joint_friction
  // unless there is `friction`, a joint that is not enabled, an actuator input; gains, damping or
  // limits of dofs that have no drive; body_flags by which other bodies are kinematic. `control`
  // null: the model's. ErrorKind::Value: EditedValues::check_joints. Looks at arrays again when
  // they were written.
  void check_values(const Model& model, const Control* control, bool friction, const char* user);
  // "dof 3 (joint 'elbow')"
  std::string dof_name(const Model& model, int32_t dof) const;
  // "the mass matrix" of the dof's articulation. Where joints follow others, with its condition at
  // the state (null: without), if that is above 1e5.
  std::string matrix_name(const Model& model, int32_t dof, const SimState* state) const;

 private:
  void check_drives(const Model& model, const char* user) const;

  DeviceArray<int32_t> rows_, links_, dof_parent_;
  std::vector<articulation::LinkJoint> joint_of_dof_;
  std::vector<char> in_long_tree_;  // rows of dofs: one without a mass matrix
  std::vector<char> kinematic_;     // bodies
  int32_t max_links_ = 0, max_dofs_ = 0;
  EditedValues values_;
  std::vector<ArrayStamp> checked_;
};

}  // namespace novaphy
