// Checks of the bodies of SolverVBD: features that are not supported, and the inputs and results of
// a step.
#include <cmath>

#include "bodies.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/input_checks.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

void check_joints(const Model& m) {
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const auto at = static_cast<size_t>(j);
    const auto type = static_cast<JointType>(m.joint_type.data()[j]);
    require(!joint_traits(type).is_chain, ErrorKind::NotImplemented, "SolverVBD: model: joint ", j,
            " ('", m.joint_label[at], "'): expected no ", joint_type_name(type),
            " joint; use SolverFeatherstone");
    require(m.joint_mimic.data()[j] < 0, ErrorKind::NotImplemented, "SolverVBD: model: joint ", j,
            " ('", m.joint_label[at], "') follows joint ", m.joint_mimic.data()[j],
            ": use SolverFeatherstone");
  }
}

// Raises an error for properties of degrees of freedom that the rows of VBD do not support.
void check_dofs(const Model& m, const Control* control) {
  const float* const act = (control != nullptr ? control->joint_act : m.joint_act).data();
  const float* const force = (control != nullptr ? control->joint_f : m.joint_f).data();
  const auto refuse = [](const char* name, int32_t k, float expected, float got) {
    require(got == expected, ErrorKind::NotImplemented, "SolverVBD: ", name, "[", k, "]: expected ",
            expected, ", because rows of VBD do not have it, got ", got);
  };
  const auto check = [](const char* name, int32_t k, float got) {
    require(got >= 0.0f && std::isfinite(got), ErrorKind::Value, "SolverVBD: ", name, "[", k,
            "]: expected a finite number of at least 0, got ", got);
  };
  for (int32_t k = 0; k < m.joint_dof_count(); ++k) {
    check("joint_friction", k, m.joint_friction.data()[k]);
    check("joint_armature", k, m.joint_armature.data()[k]);
    refuse("joint_velocity_limit", k, 1.0e6f, m.joint_velocity_limit.data()[k]);
    refuse("joint_act", k, 0.0f, act[k]);
  }
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const auto type = static_cast<JointType>(m.joint_type.data()[j]);
    if (has_axes(type)) continue;
    for (int32_t k = m.joint_qd_start.data()[j]; k < m.joint_qd_start.data()[j + 1]; ++k) {
      if (type == JointType::ROD) {
        check("joint_target_ke", k, m.joint_target_ke.data()[k]);
        check("joint_target_kd", k, m.joint_target_kd.data()[k]);
      } else {
        refuse("joint_target_ke", k, 0.0f, m.joint_target_ke.data()[k]);
        refuse("joint_target_kd", k, 0.0f, m.joint_target_kd.data()[k]);
      }
      refuse("joint_damping", k, 0.0f, m.joint_damping.data()[k]);
      refuse("joint_friction", k, 0.0f, m.joint_friction.data()[k]);
      refuse("joint_armature", k, 0.0f, m.joint_armature.data()[k]);
      refuse("joint_f", k, 0.0f, force[k]);
    }
  }
}

}  // namespace

void Bodies::check_model(const Control* control) const {
  const Model& m = model_;
  require_cpu(m.device(), "SolverVBD: model with bodies");
  const std::pair<const char*, bool> others[] = {{"tolerance", options_.tolerance.has_value()},
                                                 {"solve=\"converged\"", options_.converged}};
  for (const auto& [name, is_given] : others)
    require(!is_given, ErrorKind::NotImplemented, "SolverVBD: ", name,
            ": not supported for a model with bodies, whose steps have no residual");
  require(m.actuator_count() == 0, ErrorKind::NotImplemented,
          "SolverVBD: model: expected no actuators, got ", m.actuator_count(),
          "; use SolverFeatherstone");
  check_joints(m);
  check_dofs(m, control);
}

void Bodies::check_step(const SimState& in, const Contacts* contacts) const {
  check_rotations(kName, in);
  const auto check = [](const char* name, size_t row, const SpatialVectorf& v) {
    require(std::isfinite(math::dot(v.linear, v.linear) + math::dot(v.angular, v.angular)),
            ErrorKind::Value, kName, ": ", name, "[", row, "]: expected finite numbers");
  };
  for (size_t b = 0; b < body_.size(); ++b) {
    const Vec3f& p = in.body_q.data()[b].p;
    require(std::isfinite(math::dot(p, p)), ErrorKind::Value, kName, ": state_in.body_q[", b,
            "]: expected finite numbers, got ", p.x, ", ", p.y, ", ", p.z);
    check("state_in.body_qd", b, in.body_qd.data()[b]);
    check("state_in.body_f", b, in.body_f.data()[b]);
  }
  if (contacts == nullptr) return;
  const int32_t count = *contacts->rigid_contact_count.data();
  require(count >= 0, ErrorKind::Value, kName,
          ": contacts.rigid_contact_count: expected at least 0, got ", count);
  require(count <= contacts->rigid_contact_max(), ErrorKind::Runtime, kName, ": contacts: ", count,
          " rigid contacts were found, but there are rows for ", contacts->rigid_contact_max(),
          "; make a pipeline with a larger rigid_contact_max");
  for (int32_t k = 0; k < count; ++k) {
    const Vec3f sum = contacts->rigid_contact_normal.data()[k] +
                      contacts->rigid_contact_point0.data()[k] +
                      contacts->rigid_contact_point1.data()[k];
    require(std::isfinite(math::dot(sum, sum)), ErrorKind::Value, kName, ": contacts: contact ", k,
            ": expected finite points and a finite normal");
  }
}

// Called before the step writes its results.
void Bodies::check_result() const {
  for (size_t b = 0; b < motion_.size(); ++b)
    require(std::isfinite(math::dot(motion_[b].moved, motion_[b].moved) +
                          math::dot(motion_[b].turn, motion_[b].turn)),
            ErrorKind::Runtime, kName, ": body ", b,
            ": its pose is no longer finite; state_out was not written");
}

}  // namespace novaphy::vbd
