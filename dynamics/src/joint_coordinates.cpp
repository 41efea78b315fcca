#include "novaphy/dynamics/joint_coordinates.h"

#include <cmath>
#include <vector>

#include "joint_coordinates_kernels.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/core/storage.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace detail {
const char* joint_coordinates_kernels_source();
}
namespace {

// The object is never destroyed, because recordings refer to the kernels.
struct Kernels {
  Kernel<EvalFkArguments> fk{eval_fk_articulation, detail::joint_coordinates_kernels_source};
  Kernel<EvalIkArguments> ik{eval_ik_joint, detail::joint_coordinates_kernels_source};
  Kernel<EvalMimicArguments> mimic{eval_mimic_joint, detail::joint_coordinates_kernels_source};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

void check_coordinates(const char* name, const Model& m, const DeviceArray<float>& q,
                       const DeviceArray<float>& qd) {
  m.check_structure(name);
  const auto check = [&](const char* argument, const DeviceArray<float>& array, int32_t rows) {
    require(array.rows() == static_cast<size_t>(rows) && array.width() == 1 &&
                (rows == 0 || array.device() == m.device()),
            ErrorKind::Value, name, ": ", argument, ": expected ", rows, " rows on ",
            m.device().str(), ", got ", array.rows());
  };
  check("joint_q", q, m.joint_coord_count());
  check("joint_qd", qd, m.joint_dof_count());
}
void check_arguments(const char* name, const Model& m, const SimState& state,
                     const DeviceArray<float>& q, const DeviceArray<float>& qd) {
  require(state.model_id() == m.id(), ErrorKind::Value, name,
          ": state: expected one of the model, got one of another model");
  check_coordinates(name, m, q, qd);
}
// Throws for a quaternion of length 0. Call this before anything is written.
void check_quaternions(const Model& m, const float* q) {
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const int32_t at = quaternion_at(static_cast<JointType>(m.joint_type.data()[j]));
    if (m.joint_articulation.data()[j] < 0 || at < 0) continue;
    const float* const r = q + m.joint_q_start.data()[j] + at;
    const float square = ((r[0] * r[0] + r[1] * r[1]) + r[2] * r[2]) + r[3] * r[3];
    require(square > 0.0f && std::isfinite(square), ErrorKind::Value, "eval_fk: joint_q of joint ",
            j, ": expected a quaternion that is not zero, got (", r[0], ", ", r[1], ", ", r[2],
            ", ", r[3], ")");
  }
}

void check_perpendicular(const Model& m) {
  const OnHost<int32_t> type(m.joint_type), start(m.joint_qd_start);
  const OnHost<Vec2i> dims(m.joint_dof_dim);
  const OnHost<Vec3f> axis(m.joint_axis);
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const auto joint = static_cast<size_t>(j);
    if (!joint_traits(static_cast<JointType>(type[joint])).is_chain) continue;
    const Vec3f* const axes = axis.data() + start[joint];
    const int linear = dims[joint].x, all = linear + dims[joint].y;
    for (int a = 0; a < all; ++a)
      for (int b = a + 1; b < (a < linear ? linear : all); ++b)
        require(std::abs(math::dot(axes[a], axes[b])) < 1e-3f, ErrorKind::NotImplemented,
                "eval_ik: joint ", j, ": expected perpendicular axes of a D6 joint");
  }
}

JointArrays joints_of(const Model& m) {
  return {.joint_type = m.joint_type,
          .joint_parent = m.joint_parent,
          .joint_child = m.joint_child,
          .joint_q_start = m.joint_q_start,
          .joint_qd_start = m.joint_qd_start,
          .joint_dof_dim = m.joint_dof_dim,
          .joint_X_p = m.joint_X_p,
          .joint_X_c = m.joint_X_c,
          .joint_axis = m.joint_axis,
          .body_com = m.body_com};
}

}  // namespace

void eval_fk(const Model& m, const DeviceArray<float>& joint_q, const DeviceArray<float>& joint_qd,
             SimState& state) {
  constexpr const char* kName = "eval_fk";
  check_arguments(kName, m, state, joint_q, joint_qd);
  // The check needs values that are already on the host.
  if (runs_at_once(m.device())) check_quaternions(m, joint_q.data());
  DeviceArray<float> places;  // rows of BodyPlace
  {
    const UntrackedScope untracked;
    constexpr size_t kNumbers = sizeof(BodyPlace) / sizeof(float);
    places = DeviceArray<float>(static_cast<size_t>(m.body_count()), m.device(), kNumbers);
  }
  run(kernels().fk, m.articulation_count(),
      {.joints = joints_of(m),
       .articulation_start = m.articulation_start,
       .articulation_end = m.articulation_end,
       .joint_q = joint_q,
       .joint_qd = joint_qd,
       .body_q = state.body_q,
       .body_qd = state.body_qd,
       .places = Untyped(places)});
}

void eval_ik(const Model& m, const SimState& state, DeviceArray<float> joint_q,
             DeviceArray<float> joint_qd) {
  constexpr const char* kName = "eval_ik";
  check_arguments(kName, m, state, joint_q, joint_qd);
  {
    const UntrackedScope untracked;
    check_perpendicular(m);
  }
  depend_on({&m.joint_axis});
  run(kernels().ik, m.joint_count(),
      {.joints = joints_of(m),
       .body_q = state.body_q,
       .body_qd = state.body_qd,
       .joint_q = joint_q,
       .joint_qd = joint_qd});
}

void eval_mimic(const Model& m, DeviceArray<float> joint_q, DeviceArray<float> joint_qd) {
  constexpr const char* kName = "eval_mimic";
  check_coordinates(kName, m, joint_q, joint_qd);
  run(kernels().mimic, m.joint_count(),
      {.joint_mimic = m.joint_mimic,
       .joint_q_start = m.joint_q_start,
       .joint_qd_start = m.joint_qd_start,
       .joint_mimic_coef = m.joint_mimic_coef,
       .joint_q = joint_q,
       .joint_qd = joint_qd});
}

}  // namespace novaphy
