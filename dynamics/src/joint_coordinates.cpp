#include "novaphy/dynamics/joint_coordinates.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"
#include "novaphy/dynamics/joint_kinematics_trace.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

void check_arguments(const char* name, const Model& m, const SimState& state,
                     const DeviceArray<float>& q, const DeviceArray<float>& qd) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation(name);
  require(m.device().is_cpu(), ErrorKind::NotImplemented, name,
          ": model: expected one on the cpu, got one on ", m.device().str());
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

struct Joints {
  explicit Joints(const Model& model)
      : type(model.joint_type.data()),
        parent(model.joint_parent.data()),
        child(model.joint_child.data()),
        q_start(model.joint_q_start.data()),
        qd_start(model.joint_qd_start.data()),
        dims(model.joint_dof_dim.data()),
        x_p(model.joint_X_p.data()),
        x_c(model.joint_X_c.data()),
        axis(model.joint_axis.data()) {}
  const int32_t *type, *parent, *child, *q_start, *qd_start;
  const Vec2i* dims;
  const Transformf *x_p, *x_c;
  const Vec3f* axis;

  bool is(int32_t j, JointType wanted) const { return type[j] == static_cast<int32_t>(wanted); }
  bool is_six(int32_t j) const { return is(j, JointType::FREE) || is(j, JointType::DISTANCE); }
  JointAxes<float> axes(int32_t j) const {
    return {axis + qd_start[j], dims[j].x, dims[j].y, is(j, JointType::BALL)};
  }
};

// A unit quaternion keeps its bits.
Quatf unit(const Quatf& q, int32_t joint) {
  const float square = ((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w;
  require(square > 0.0f && std::isfinite(square), ErrorKind::Value, "eval_fk: joint_q of joint ",
          joint, ": expected a quaternion that is not zero, got (", q.x, ", ", q.y, ", ", q.z, ", ",
          q.w, ")");
  if (std::abs(square - 1.0f) <= 0x1p-22f) return q;
  const float scale = 1.0f / math::sqrt(square);
  return {q.x * scale, q.y * scale, q.z * scale, q.w * scale};
}

struct Frame {
  Transformf pose = Transformf::identity();
  SpatialVectorf twist{};  // of the point `com`
  Vec3f com{};             // world
  Vec3f velocity(const Vec3f& point) const {
    return twist.linear + math::cross(twist.angular, point - com);
  }
};
Frame frame_of(const Model& m, const Transformf* q, const SpatialVectorf* qd, int32_t body) {
  if (body < 0) return {};
  return {q[body], qd[body], math::transform_point(q[body], m.body_com.data()[body])};
}

void check_perpendicular(const Joints& joints, int32_t j) {
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
  check_arguments("eval_fk", m, state, joint_q, joint_qd);
  const Joints joints(m);
  const int32_t* const articulation = m.joint_articulation.data();
  const float *const q = joint_q.data(), *const qd = joint_qd.data();
  // Nothing is written where a quaternion is refused.
  std::vector<Transformf> poses = state.body_q.to_host();
  std::vector<SpatialVectorf> twists = state.body_qd.to_host();
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    if (articulation[j] < 0) continue;
    const float *const c = q + joints.q_start[j], *const rate = qd + joints.qd_start[j];
    const Frame parent = frame_of(m, poses.data(), twists.data(), joints.parent[j]);
    const Transformf anchor = math::multiply(parent.pose, joints.x_p[j]);
    JointMotion<float> motion;
    if (joints.is_six(j)) {
      motion.pose = {{c[0], c[1], c[2]}, unit({c[3], c[4], c[5], c[6]}, j)};
      motion.rate = {{rate[0], rate[1], rate[2]}, {rate[3], rate[4], rate[5]}};
    } else {
      motion = joint_motion(joints.axes(j), c, rate);
      if (joints.is(j, JointType::BALL)) motion.pose.q = unit(motion.pose.q, j);
    }
    const auto child = static_cast<size_t>(joints.child[j]);
    const Transformf at = math::multiply(anchor, motion.pose);
    const Transformf pose = math::multiply(at, math::inverse(joints.x_c[j]));
    const Vec3f com = math::transform_point(pose, m.body_com.data()[child]);
    const Vec3f w = math::rotate(anchor.q, motion.rate.angular);
    // The rate is that of the centre of mass for FREE, of the joint frame's origin for the others.
    const Vec3f arm = joints.is_six(j) ? Vec3f{} : com - at.p;
    const Vec3f v = math::rotate(anchor.q, motion.rate.linear) + math::cross(w, arm);
    poses[child] = pose;
    twists[child] = {parent.velocity(com) + v, parent.twist.angular + w};
  }
  state.body_q.copy_from_host(std::span<const Transformf>(poses));
  state.body_qd.copy_from_host(std::span<const SpatialVectorf>(twists));
}

void eval_ik(const Model& m, const SimState& state, DeviceArray<float> joint_q,
             DeviceArray<float> joint_qd) {
  check_arguments("eval_ik", m, state, joint_q, joint_qd);
  const Joints joints(m);
  for (int32_t j = 0; j < m.joint_count(); ++j) check_perpendicular(joints, j);
  const Transformf* const poses = state.body_q.data();
  const SpatialVectorf* const twists = state.body_qd.data();
  float *const q = joint_q.mutable_data(), *const qd = joint_qd.mutable_data();
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    float *const c = q + joints.q_start[j], *const rate = qd + joints.qd_start[j];
    const Frame parent = frame_of(m, poses, twists, joints.parent[j]);
    const Frame child = frame_of(m, poses, twists, joints.child[j]);
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
