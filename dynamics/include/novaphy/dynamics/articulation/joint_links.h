// The links of a joint of a model: one link, or a chain with one link per axis (tree.h).
#pragma once

#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/articulation/tree.h"

namespace novaphy::articulation {

// A joint's rows in the model's arrays, and its numbers of dofs: all dofs, and linear dofs.
struct JointRows {
  JointType type = JointType::FIXED;
  int32_t joint = 0, child = 0, coord = 0, dof = 0, dofs = 0, linear = 0;
};

inline int32_t link_count(const JointRows& j) {
  return joint_traits(j.type).is_chain && j.dofs > 1 ? j.dofs : 1;
}

// Returns link k of a joint. `parent`: the previous link. DISTANCE and ROD joints move like FREE
// joints.
inline Link joint_link(const JointRows& j, int32_t k, int32_t parent) {
  const bool chain = joint_traits(j.type).is_chain, last = k == link_count(j) - 1;
  const LinkJoint whole = has_pose(j.type) ? LinkJoint::Free : static_cast<LinkJoint>(j.type);
  const LinkJoint part = j.dofs == 0    ? LinkJoint::Fixed
                         : k < j.linear ? LinkJoint::Prismatic
                                        : LinkJoint::Revolute;
  const int32_t at = chain ? k : 0;
  return {.joint = chain ? part : whole,
          .parent = parent,
          .frame_p = k == 0 ? j.joint : -1,
          .frame_c = last ? j.joint : -1,
          .body = last ? j.child : -1,
          .coord = j.coord + at,
          .dof = j.dof + at,
          .dofs = chain && j.dofs > 1 ? 1 : j.dofs};
}

}  // namespace novaphy::articulation
