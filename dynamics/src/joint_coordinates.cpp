#include "novaphy/dynamics/joint_coordinates.h"

#include <cmath>
#include <initializer_list>
#include <vector>

#include "joint_coordinates_kernels.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/core/storage.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace detail {
const char* joint_coordinates_kernels_text();
}
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel fk{eval_fk_articulation, detail::joint_coordinates_kernels_text};
  DeviceKernel ik{eval_ik_joint, detail::joint_coordinates_kernels_text};
  DeviceKernel mimic{eval_mimic_joint, detail::joint_coordinates_kernels_text};
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
// What a launch on the cpu is for tapes and captures; on devices it is recorded.
void check_recorders(const char* name, const Model& m) {
  if (!m.device().is_cpu()) return;
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation(name);
}

// On the host.
JointArrays joints_of(const Model& m) {
  return {m.joint_type.data(),    m.joint_parent.data(),   m.joint_child.data(),
          m.joint_q_start.data(), m.joint_qd_start.data(), m.joint_dof_dim.data(),
          m.joint_X_p.data(),     m.joint_X_c.data(),      m.joint_axis.data(),
          m.body_com.data()};
}

// Before anything is written.
void check_quaternions(const Model& m, const float* q) {
  const JointArrays joints = joints_of(m);
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    const bool ball = joints.is(j, JointType::BALL);
    if (m.joint_articulation.data()[j] < 0 || !(ball || joints.is_six(j))) continue;
    const float* const r = q + joints.q_start[j] + (ball ? 0 : 3);
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
    if (type[joint] != static_cast<int32_t>(JointType::D6)) continue;
    const Vec3f* const axes = axis.data() + start[joint];
    const int linear = dims[joint].x, all = linear + dims[joint].y;
    for (int a = 0; a < all; ++a)
      for (int b = a + 1; b < (a < linear ? linear : all); ++b)
        require(std::abs(math::dot(axes[a], axes[b])) < 1e-3f, ErrorKind::NotImplemented,
                "eval_ik: joint ", j, ": expected perpendicular axes of a D6 joint");
  }
}

// The arguments that are JointArrays.
std::vector<LaunchArgument> joint_arguments(const Model& m) {
  return {reads("model.joint_type", m.joint_type),
          reads("model.joint_parent", m.joint_parent),
          reads("model.joint_child", m.joint_child),
          reads("model.joint_q_start", m.joint_q_start),
          reads("model.joint_qd_start", m.joint_qd_start),
          reads("model.joint_dof_dim", m.joint_dof_dim),
          reads("model.joint_X_p", m.joint_X_p),
          reads("model.joint_X_c", m.joint_X_c),
          reads("model.joint_axis", m.joint_axis),
          reads("model.body_com", m.body_com)};
}
void launch(const DeviceKernel& kernel, const Model& m, int64_t rows,
            std::initializer_list<LaunchArgument> more) {
  std::vector<LaunchArgument> arguments = joint_arguments(m);
  arguments.insert(arguments.end(), more);
  kernel.launch(m.device(), rows, arguments);
}

}  // namespace

void eval_fk(const Model& m, const DeviceArray<float>& joint_q, const DeviceArray<float>& joint_qd,
             SimState& state) {
  constexpr const char* kName = "eval_fk";
  check_recorders(kName, m);
  check_arguments(kName, m, state, joint_q, joint_qd);
  if (m.device().is_cpu()) check_quaternions(m, joint_q.data());
  DeviceArray<float> places;  // rows of BodyPlace
  {
    const Unobserved unobserved;
    constexpr size_t kNumbers = sizeof(BodyPlace) / sizeof(float);
    places = DeviceArray<float>(static_cast<size_t>(m.body_count()), m.device(), kNumbers);
  }
  launch(kernels().fk, m, m.articulation_count(),
         {reads_row("model.articulation_start", m.articulation_start),
          reads_row("model.articulation_end", m.articulation_end), reads("joint_q", joint_q),
          reads("joint_qd", joint_qd), updates("state.body_q", state.body_q).detached(),
          updates("state.body_qd", state.body_qd).detached(), writes("places", places)});
}

void eval_ik(const Model& m, const SimState& state, DeviceArray<float> joint_q,
             DeviceArray<float> joint_qd) {
  constexpr const char* kName = "eval_ik";
  check_recorders(kName, m);
  check_arguments(kName, m, state, joint_q, joint_qd);
  {
    const Unobserved unobserved;
    check_perpendicular(m);
  }
  depend_on({&m.joint_axis});
  launch(kernels().ik, m, m.joint_count(),
         {reads("state.body_q", state.body_q), reads("state.body_qd", state.body_qd),
          writes("joint_q", joint_q), writes("joint_qd", joint_qd)});
}

void eval_mimic(const Model& m, DeviceArray<float> joint_q, DeviceArray<float> joint_qd) {
  constexpr const char* kName = "eval_mimic";
  check_recorders(kName, m);
  check_coordinates(kName, m, joint_q, joint_qd);
  kernels().mimic.launch(
      m.device(), m.joint_count(),
      {reads("model.joint_mimic", m.joint_mimic), reads("model.joint_q_start", m.joint_q_start),
       reads("model.joint_qd_start", m.joint_qd_start),
       reads("model.joint_mimic_coef", m.joint_mimic_coef), updates("joint_q", joint_q),
       updates("joint_qd", joint_qd)});
}

}  // namespace novaphy
