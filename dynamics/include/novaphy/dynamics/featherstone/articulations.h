// Articulations: the articulations of a model as trees of links (articulation/tree.h), for solvers
// and dynamics functions.
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

// The constructor reads the structure of the joints once (joint_type, joint_parent, joint_child,
// articulation_start and so on). All other values are read at every use.
class NOVAPHY_DYNAMICS_API Articulations {
 public:
  // `Steps` also supports kinematic bodies.
  enum class For { Functions, Steps };
  // Messages begin with `user`. ErrorKind::NotImplemented: a joint without an articulation, a
  // DISTANCE joint, or a kinematic body. For steps, only kinematic bodies whose joint is not FREE
  // or FIXED to the world are an error. ErrorKind::Value: an error of Model::check_structure.
  Articulations(const Model& model, const char* user, For purpose = For::Functions);

  int64_t count() const { return static_cast<int64_t>(rows_.rows()); }
  int32_t max_links() const { return max_links_; }
  int32_t max_dofs() const { return max_dofs_; }
  // The next three arrays are on the model's device. rows {count}: the ArticulationRows of each
  // tree (articulation/arguments.h).
  const DeviceArray<int32_t>& rows() const { return rows_; }
  const DeviceArray<int32_t>& links() const { return links_; }  // rows of articulation::Link
  const DeviceArray<int32_t>& dof_parent() const { return dof_parent_; }
  // Returns tree i, which refers to the arrays of the model. The model must outlive the tree. CPU
  // only.
  articulation::Tree<float> tree(const Model& model, int64_t i) const;

  // Checks for values that the solver does not support. Null `control`: the model's default
  // control. Only arrays that were written since the last check are read.
  //
  // ErrorKind::NotImplemented, with the array: joint_friction unless `friction`; a joint that is
  // not enabled; an actuator input; gains, damping or limits of dofs without a drive; body_flags
  // that make other bodies kinematic than at the start. ErrorKind::Value: an error of
  // EditedValues::check_joints.
  void check_values(const Model& model, const Control* control, bool friction, const char* user);
  // Returns a text such as "dof 3 (joint 'elbow')".
  std::string dof_name(const Model& model, int32_t dof) const;
  // Returns the text "the mass matrix" for the dof's articulation. With mimic joints and a state
  // (not null), a condition number above 1e5 is added.
  std::string matrix_name(const Model& model, int32_t dof, const SimState* state) const;

 private:
  void check_drives(const Model& model, const char* user) const;

  DeviceArray<int32_t> rows_, links_, dof_parent_;
  std::vector<articulation::LinkJoint> joint_of_dof_;
  std::vector<char> in_long_tree_;  // per dof: whether its tree has no mass matrix
  std::vector<char> kinematic_;     // per body
  int32_t max_links_ = 0, max_dofs_ = 0;
  EditedValues values_;
  std::vector<ArrayStamp> checked_;
};

}  // namespace novaphy
