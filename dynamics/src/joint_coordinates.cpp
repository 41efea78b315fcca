#include "novaphy/dynamics/joint_coordinates.h"

#include <algorithm>
#include <cmath>

#include "joint_coordinates_kernels.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace detail {
const char* joint_coordinates_kernels_text();
}
namespace {

const DeviceKernel& fk_kernel() {
  static const auto& kernel =
      *new DeviceKernel(eval_fk_articulation, detail::joint_coordinates_kernels_text);
  return kernel;
}

void check_arguments(const char* name, const Model& m, const SimState& state,
                     const DeviceArray<float>& q, const DeviceArray<float>& qd) {
  m.check_structure(name);
  require(state.model_id() == m.id(), ErrorKind::Value, name,
          ": state: expected one of the model, got one of another model");
  const auto check = [&](const char* argument, const DeviceArray<float>& array, int32_t rows) {
    require(array.rows() == static_cast<size_t>(rows) && array.width() == 1 &&
                (rows == 0 || array.device() == m.device()),
            ErrorKind::Value, name, ": ", argument, ": expected ", rows, " rows on ",
            m.device().str(), ", got ", array.rows());
  };
  check("joint_q", q, m.joint_coord_count());
  check("joint_qd", qd, m.joint_dof_count());
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

void check_perpendicular(const JointArrays& joints, int32_t j) {
  const JointAxes<float> axes = joints.axes(j);
  if (!joints.is(j, JointType::D6)) return;
  for (int a = 0; a < axes.linear + axes.angular; ++a)
    for (int b = a + 1; b < (a < axes.linear ? axes.linear : axes.linear + axes.angular); ++b)
      require(std::abs(math::dot(axes.axis[a], axes.axis[b])) < 1e-3f, ErrorKind::NotImplemented,
              "eval_ik: joint ", j, ": expected perpendicular axes of a D6 joint");
}

}  // namespace

void eval_fk(const Model& m, const DeviceArray<float>& joint_q, const DeviceArray<float>& joint_qd,
             SimState& state) {
  constexpr const char* kName = "eval_fk";
  if (m.device().is_cpu()) {
    if (ArrayObserver* observer = array_observer()) observer->untracked_operation(kName);
  }
  check_arguments(kName, m, state, joint_q, joint_qd);
  if (m.device().is_cpu()) check_quaternions(m, joint_q.data());
  DeviceArray<float> places;  // rows of BodyPlace
  {
    const Unobserved unobserved;
    constexpr size_t kNumbers = sizeof(BodyPlace) / sizeof(float);
    places = DeviceArray<float>(static_cast<size_t>(m.body_count()), m.device(), kNumbers);
  }
  fk_kernel().launch(
      m.device(), m.articulation_count(),
      {reads("model.joint_type", m.joint_type), reads("model.joint_parent", m.joint_parent),
       reads("model.joint_child", m.joint_child), reads("model.joint_q_start", m.joint_q_start),
       reads("model.joint_qd_start", m.joint_qd_start),
       reads("model.joint_dof_dim", m.joint_dof_dim), reads("model.joint_X_p", m.joint_X_p),
       reads("model.joint_X_c", m.joint_X_c), reads("model.joint_axis", m.joint_axis),
       reads("model.body_com", m.body_com),
       reads_row("model.articulation_start", m.articulation_start),
       reads_row("model.articulation_end", m.articulation_end), reads("joint_q", joint_q),
       reads("joint_qd", joint_qd), updates("state.body_q", state.body_q).detached(),
       updates("state.body_qd", state.body_qd).detached(), writes("places", places)});
}

void eval_ik(const Model& m, const SimState& state, DeviceArray<float> joint_q,
             DeviceArray<float> joint_qd) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation("eval_ik");
  require(m.device().is_cpu(), ErrorKind::NotImplemented,
          "eval_ik: model: expected one on the cpu, got one on ", m.device().str());
  check_arguments("eval_ik", m, state, joint_q, joint_qd);
  const JointArrays joints = joints_of(m);
  for (int32_t j = 0; j < m.joint_count(); ++j) check_perpendicular(joints, j);
  const Transformf* const poses = state.body_q.data();
  const SpatialVectorf* const twists = state.body_qd.data();
  float *const q = joint_q.mutable_data(), *const qd = joint_qd.mutable_data();
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    float *const c = q + joints.q_start[j], *const rate = qd + joints.qd_start[j];
    const BodyFrame parent = body_frame(joints, poses, twists, joints.parent[j]);
    const BodyFrame child = body_frame(joints, poses, twists, joints.child[j]);
    const Transformf anchor = math::multiply(parent.pose, joints.x_p[j]);
    const Transformf at = math::multiply(child.pose, joints.x_c[j]);
    JointMotion<float> motion;
    motion.pose = {math::rotate_inverse(anchor.q, at.p - anchor.p),
                   math::multiply(math::conjugate(anchor.q), at.q)};
    const Vec3f point = joints.is_six(j) ? child.com : at.p;
    motion.rate = {math::rotate_inverse(anchor.q, child.velocity(point) - parent.velocity(point)),
                   math::rotate_inverse(anchor.q, child.twist.angular - parent.twist.angular)};
    if (!joints.is_six(j)) {
      joint_coordinates(joints.axes(j), motion, c, rate);
      continue;
    }
    const Transformf& x = motion.pose;
    const float pose[] = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
    const Vec3f &v = motion.rate.linear, &w = motion.rate.angular;
    const float twist[] = {v.x, v.y, v.z, w.x, w.y, w.z};
    std::copy_n(pose, 7, c);
    std::copy_n(twist, 6, rate);
  }
}

}  // namespace novaphy
