// Checks of values that were written to a model after finalize. The checks refuse every value that
// the builder refuses. A NaN or a negative stiffness is thus reported by name before the value
// spreads through the state.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// X(array, rule). All numbers must be finite. Further rules:
//   NotNegative  >= 0
//   Mass         0, or with a finite inverse
//   Unread       0, because the solver does not read the array
//   UnitPose     quaternion of length 1
//   NotZero      an axis or quaternion of length > 0; an optimizer may change the length of a
//                joint's axis or quaternion, because these have a gradient
//   RestPose     determinant > 0
//   Elastic      k_mu, k_damp >= 0; k_lambda >= 0, or a bulk modulus >= 0 with Lame parameters
#define NOVAPHY_EDITED_ARRAYS(X)              \
  X(gravity, Finite)                          \
  X(body_gravcomp, Unread)                    \
  X(fluid_density, Unread)                    \
  X(fluid_viscosity, Unread)                  \
  X(particle_mass, Mass)                      \
  X(particle_inv_mass, NotNegative)           \
  X(particle_radius, NotNegative)             \
  X(particle_spring_stiffness, NotNegative)   \
  X(particle_spring_damping, NotNegative)     \
  X(particle_spring_rest_length, NotNegative) \
  X(particle_tri_pose, RestPose)              \
  X(particle_tri_area, NotNegative)           \
  X(particle_tri_activation, Finite)          \
  X(particle_tri_material, NotNegative)       \
  X(particle_edge_rest_angle, Finite)         \
  X(particle_edge_rest_length, NotNegative)   \
  X(particle_edge_material, NotNegative)      \
  X(particle_tet_pose, RestPose)              \
  X(particle_tet_activation, Finite)          \
  X(particle_tet_material, Elastic)           \
  X(joint_X_p, NotZero)                       \
  X(joint_X_c, NotZero)                       \
  X(joint_axis, NotZero)                      \
  X(joint_f, Finite)                          \
  X(joint_target_q, Finite)                   \
  X(joint_target_qd, Finite)                  \
  X(joint_target_ke, NotNegative)             \
  X(joint_target_kd, NotNegative)             \
  X(joint_damping, NotNegative)               \
  X(joint_limit_lower, Finite)                \
  X(joint_limit_upper, Finite)                \
  X(joint_limit_ke, NotNegative)              \
  X(joint_limit_kd, NotNegative)              \
  X(joint_effort_limit, NotNegative)          \
  X(shape_transform, UnitPose)                \
  X(shape_scale, NotNegative)                 \
  X(shape_material_ke, NotNegative)           \
  X(shape_material_kd, NotNegative)           \
  X(shape_material_kf, NotNegative)           \
  X(shape_material_ka, NotNegative)           \
  X(shape_material_mu, NotNegative)           \
  X(shape_gap, NotNegative)                   \
  X(shape_margin, Finite)

class NOVAPHY_CORE_API EditedValues {
 public:
  explicit EditedValues(const char* solver) : solver_(solver) {}

  // Checks the arrays of NOVAPHY_EDITED_ARRAYS. A call is cheap if no array was written since the
  // last call. Throws ErrorKind::NotImplemented if the model has actuators. ErrorKind::Value names
  // the array and the row. Besides the rules of the list:
  //   joint_limit_lower <= joint_limit_upper; body_com is finite
  //   dynamic bodies have body_mass > 0 and finite inverses; their body_inertia is positive
  //     definite and symmetric (to 1e-5 of its largest number)
  //   derived arrays agree with their sources
  // On devices other than the CPU, arrays with a writable export are not read. The recorder is not
  // told that the host reads the arrays, because no kernel depends on the result. While a capture
  // records on the CPU, every replay repeats the check.
  void check(const Model& model);
  // Checks the arrays that articulations read, with the same cost and errors as check():
  //   finite and >= 0: joint_armature, _damping, _friction, _target_ke, _kd, _limit_ke, _kd,
  //     _effort_limit, _velocity_limit, body_mass (a link may have 0), the diagonal of
  //     body_inertia, shape_material_*, shape_scale and _gap; restitution <= 1
  //   joint_limit_lower <= joint_limit_upper; joint_target_mode is a JointTargetMode
  //   unit length (to 1e-3): joint_axis, the quaternions of joint_X_p and _X_c; (to 1e-5): the
  //     quaternion of shape_transform
  //   finite: all of these, gravity, shape_margin and body_com
  void check_joints(const Model& model);

 private:
#define NOVAPHY_COUNT(name, rule) +1
  static constexpr size_t kBodyArrays = 6, kArrays = 0 NOVAPHY_EDITED_ARRAYS(NOVAPHY_COUNT);
#undef NOVAPHY_COUNT
  void check_bodies(const Model& model);
  void check_arrays(const Model& model);
  void check_joint_arrays(const Model& model);
  void check_limits(const Model& model);
  template <class Check>
  void check_all(const Model& model, Check check);

  const char* solver_;
  // identifies this object to recordings
  std::shared_ptr<const int> id_ = std::make_shared<const int>(0);
  std::array<ArrayStamp, kBodyArrays> bodies_;
  std::array<ArrayStamp, kArrays> arrays_;
  std::vector<ArrayStamp> joints_;  // stamps of the arrays that check_joints reads
  ArrayStamp limits_[2];            // stamps of joint_limit_lower and _upper
};

}  // namespace novaphy
