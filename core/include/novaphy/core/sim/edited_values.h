// Checks of values that were written to a model after it was made. A value that the builder would
// have refused is refused, so that a NaN or a negative stiffness is named and does not spread
// through the state.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

// X(array, rule). All numbers must be finite. NotNegative: and >= 0. Mass: and have a finite
// inverse, or be 0. Unread: and be 0. UnitPose: the quaternion has length 1. NotZero: axis or
// quaternion has a length (those of joints have a gradient, and may leave 1). RestPose: the
// determinant is > 0.
#define NOVAPHY_EDITED_ARRAYS(X)              \
  X(gravity, Finite)                          \
  X(body_gravcomp, Unread)                    \
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
  X(particle_tet_material, NotNegative)       \
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

  // ErrorKind::NotImplemented: a model with actuators.
  // Cheap while the arrays were not written since the last call. ErrorKind::Value names array and
  // row: what NOVAPHY_EDITED_ARRAYS asks for; joint_limit_lower at most joint_limit_upper; body_com
  // finite; of dynamic bodies body_mass > 0, body_inertia symmetric (to 1e-5 of its largest number)
  // and positive definite, the inverses finite. The derived arrays
  // must be those of their sources. On other devices than the CPU, arrays that another library may
  // write are not read. Host reads are not observed: no kernel depends on them. While a capture
  // records on the CPU, every replay will check too.
  void check(const Model& model);
  // Likewise, of what articulations read: joint_armature, _damping, _friction, _target_ke, _kd,
  // _limit_ke, _kd, _effort_limit, _velocity_limit, body_mass (links may have none), the diagonal
  // of body_inertia, shape_material_*, shape_scale and _gap finite and >= 0, restitution <= 1;
  // joint_limit_lower at most joint_limit_upper; joint_target_mode a JointTargetMode; joint_axis
  // and the quaternions of joint_X_p, _X_c of length 1 (to 1e-3), that of shape_transform (to
  // 1e-5); all of these, gravity, shape_margin and body_com finite.
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
  std::shared_ptr<const int> id_ = std::make_shared<const int>(0);  // to recordings
  std::array<ArrayStamp, kBodyArrays> bodies_;
  std::array<ArrayStamp, kArrays> arrays_;
  std::vector<ArrayStamp> joints_;  // of the arrays of check_joints, in its order
  ArrayStamp limits_[2];            // lower, upper
};

}  // namespace novaphy
