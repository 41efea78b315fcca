#include "joint_forces.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "../step_sources.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/semi_implicit/penalty_joint_trace.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

constexpr int64_t kJointChunk = 64;

JointType type_of(const Model& m, int32_t joint) {
  return static_cast<JointType>(m.joint_type.data()[joint]);
}

// Throws for arrays that have no effect on penalty joints.
void check_unused(const Model& m, const char* solver) {
  const std::vector<int32_t> leader = m.joint_mimic.to_host();
  for (size_t j = 0; j < leader.size(); ++j)
    require(leader[j] < 0, ErrorKind::NotImplemented, solver, ": model: joint ", j, " ('",
            m.joint_label[j], "') mimics joint ", leader[j],
            ": mimic joints are not supported; use SolverFeatherstone");
  const auto check = [&](const char* name, const DeviceArray<float>& array, float by_default) {
    const std::vector<float> values = array.to_host();
    for (size_t k = 0; k < values.size(); ++k)
      require(values[k] == by_default, ErrorKind::NotImplemented, solver, ": model.", name, "[", k,
              "]: expected ", by_default, ", because penalty joints do not have it, got ",
              values[k]);
  };
  check("joint_armature", m.joint_armature, 0.0f);
  check("joint_friction", m.joint_friction, 0.0f);
  check("joint_velocity_limit", m.joint_velocity_limit, 1.0e6f);
}

// Checks BALL, FREE and DISTANCE joints, which have no drive. Only DISTANCE has a limit, the
// distance.
void check_without_drive(const Model& m, const char* solver) {
  const std::vector<int32_t> type = m.joint_type.to_host(), start = m.joint_qd_start.to_host();
  const auto check = [&](const char* name, const DeviceArray<float>& array, float by_default,
                         bool of_ball, bool of_distance) {
    const std::vector<float> values = array.to_host();
    for (size_t j = 0; j < type.size(); ++j) {
      const JointTraits traits = joint_traits(static_cast<JointType>(type[j]));
      const bool distance = traits.constraint == JointConstraint::DISTANCE;
      if (traits.quaternion < (of_ball ? 0 : 1)) continue;
      for (int32_t k = start[j] + (distance && of_distance ? 1 : 0); k < start[j + 1]; ++k)
        require(values[static_cast<size_t>(k)] == by_default, ErrorKind::NotImplemented, solver,
                ": model.", name, "[", k, "]: expected ", by_default, " of a ",
                joint_type_name(static_cast<JointType>(type[j])), " joint, got ",
                values[static_cast<size_t>(k)]);
    }
  };
  check("joint_target_ke", m.joint_target_ke, 0.0f, true, false);
  check("joint_target_kd", m.joint_target_kd, 0.0f, true, false);
  check("joint_damping", m.joint_damping, 0.0f, false, false);
  check("joint_limit_lower", m.joint_limit_lower, -kJointUnlimited, true, true);
  check("joint_limit_upper", m.joint_limit_upper, kJointUnlimited, true, true);
}

void check_perpendicular(const std::vector<Vec3f>& axes, int32_t begin, int32_t end, size_t joint,
                         const char* solver) {
  for (int32_t a = begin; a < end; ++a)
    for (int32_t b = a + 1; b < end; ++b)
      require(
          std::abs(math::dot(axes[static_cast<size_t>(a)], axes[static_cast<size_t>(b)])) < 1e-3f,
          ErrorKind::NotImplemented, solver, ": joint ", joint,
          ": expected perpendicular axes of a D6 joint, got model.joint_axis rows ", a, " and ", b);
}

}  // namespace

// Host copies of the arrays that `prepare` reads. The model may be on any device.
struct HostJoints {
  explicit HostJoints(const Model& m)
      : type(m.joint_type.to_host()),
        parent(m.joint_parent.to_host()),
        child(m.joint_child.to_host()),
        qd_start(m.joint_qd_start.to_host()),
        flags(m.body_flags.to_host()),
        enabled(m.joint_enabled.to_host()),
        dims(m.joint_dof_dim.to_host()),
        frame{m.joint_X_p.to_host(), m.joint_X_c.to_host()},
        axis(m.joint_axis.to_host()),
        com(m.body_com.to_host()),
        inv_mass(m.body_inv_mass.to_host()),
        inv_inertia(m.body_inv_inertia.to_host()) {}
  JointType type_of(size_t joint) const { return static_cast<JointType>(type[joint]); }

  std::vector<int32_t> type, parent, child, qd_start, flags;
  std::vector<uint8_t> enabled;
  std::vector<Vec2i> dims;
  std::vector<Transformf> frame[2];  // joint frames in the parent and in the child
  std::vector<Vec3f> axis, com;
  std::vector<float> inv_mass;
  std::vector<Mat33f> inv_inertia;
};

namespace {

// The inverse mass (1/kg) and inverse inertia (1/(kg m^2)) of a body, in world axes at its pose in
// the model. Zero for the world and for kinematic bodies, which forces do not move.
struct Mobility {
  float linear = 0.0f;
  Mat33f angular{};
};
Mobility mobility(const HostJoints& m, int32_t body) {
  const auto b = static_cast<size_t>(body);
  if (body < 0 || has_flag(m.flags[b], BodyFlags::KINEMATIC)) return {};
  return {m.inv_mass[b], m.inv_inertia[b]};
}

float along(const Mat33f& a, const Vec3f& n) {
  float sum = 0.0f;
  const float v[3] = {n.x, n.y, n.z};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) sum += v[i] * a.m[i][k] * v[k];
  return sum;
}

// Returns the largest n . a n over unit vectors n perpendicular to `axis`, by power iteration. With
// a zero `axis` n is any unit vector.
float largest_along(const Mat33f& a, const Vec3f& axis) {
  float largest = 0.0f;
  for (const Vec3f& start : {Vec3f{1.0f, 0.3f, 0.2f}, Vec3f{0.2f, 1.0f, 0.3f}}) {
    Vec3f n = start;
    for (int step = 0; step < 32; ++step) {
      n = math::normalize(n - axis * math::dot(axis, n));
      largest = std::max(largest, along(a, n));
      n = {a.m[0][0] * n.x + a.m[0][1] * n.y + a.m[0][2] * n.z,
           a.m[1][0] * n.x + a.m[1][1] * n.y + a.m[1][2] * n.z,
           a.m[2][0] * n.x + a.m[2][1] * n.y + a.m[2][2] * n.z};
    }
  }
  return largest;
}

// Returns the inverse mass matrix of a point at `arm` from the center of mass: 1/m + [arm]^T I^-1
// [arm].
Mat33f mobility_at(const Mobility& body, const Vec3f& arm) {
  const float cross[3][3] = {{0.0f, -arm.z, arm.y}, {arm.z, 0.0f, -arm.x}, {-arm.y, arm.x, 0.0f}};
  Mat33f w{};
  for (int i = 0; i < 3; ++i) {
    w.m[i][i] = body.linear;
    for (int k = 0; k < 3; ++k)
      for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) w.m[i][k] += cross[a][i] * body.angular.m[a][b] * cross[b][k];
  }
  return w;
}

// Returns the dt that solves ke w dt^2 + 2 kd w dt = 4. Up to this dt, symplectic Euler is stable
// for a mode with the inverse mass w.
float stable_dt(float w, float ke, float kd) {
  return w > 0.0f ? 4.0f / w / (kd + std::sqrt(kd * kd + 4.0f * ke / w))
                  : std::numeric_limits<float>::infinity();
}

struct DofArrays {
  DofArrays(const Model& m, const Control* control) : mode(m.joint_target_mode.data()) {
    articulation::for_each_array(
        [&](auto& to, const auto& source) {
          if (source.in_model != nullptr) to = source.find(m, nullptr, control)->data();
        },
        arrays, kStepSources);
  }
  articulation::StepArrays<articulation::ReadPointers<float>> arrays = {};
  const int32_t* mode;

  // Returns the parameters of a degree of freedom. `q`: its coordinate; -1: no target.
  JointDof<float> at(int32_t dof, int32_t q) const {
    const auto which = static_cast<JointTargetMode>(mode[dof]);
    const bool both = which == JointTargetMode::POSITION_VELOCITY;
    JointDof<float> d{.axis = arrays.axis[dof]};
    for_each_dof_number(
        [&](float& to, const float* from, int32_t place) {
          const int32_t row = place == kAt.target_q ? q : dof;
          if (row >= 0) to = from[row];
        },
        d, arrays, kAt);
    select_drive(q >= 0 && (both || which == JointTargetMode::POSITION),
                 both || which == JointTargetMode::VELOCITY, d);
    return d;
  }
};

}  // namespace

void JointForces::check_covered(const Model& m, const char* solver) {
  m.check_structure(solver);
  const std::vector<int32_t> type = m.joint_type.to_host(), start = m.joint_qd_start.to_host();
  const std::vector<Vec2i> dims = m.joint_dof_dim.to_host();
  const std::vector<Vec3f> axes = m.joint_axis.to_host();
  const std::vector<int32_t> flags = m.body_flags.to_host();
  const std::vector<float> mass = m.body_mass.to_host();
  for (size_t j = 0; j < type.size(); ++j) {
    if (!joint_traits(static_cast<JointType>(type[j])).is_chain) continue;
    const int32_t first = start[j], middle = first + dims[j].x;
    check_perpendicular(axes, first, middle, j, solver);
    check_perpendicular(axes, middle, middle + dims[j].y, j, solver);
  }
  for (size_t b = 0; b < mass.size(); ++b)
    require(mass[b] > 0.0f || has_flag(flags[b], BodyFlags::KINEMATIC), ErrorKind::Value, solver,
            ": model.body_mass[", b,
            "]: expected > 0: penalty joints do not move a link without mass; give it a mass, make "
            "it kinematic, or merge it by ModelBuilder.collapse_fixed_joints, got ",
            mass[b]);
  check_unused(m, solver);
  check_without_drive(m, solver);
}

void JointForces::check_edits(const Model& m, const Control* control, const char* solver) {
  const DeviceArray<float>& joint_act = control ? control->joint_act : m.joint_act;
  depend_on({&m.joint_armature, &m.joint_friction, &m.joint_velocity_limit, &joint_act});
  const Array* const arrays[] = {&m.joint_armature, &m.joint_friction,    &m.joint_velocity_limit,
                                 &joint_act,        &m.joint_target_ke,   &m.joint_target_kd,
                                 &m.joint_damping,  &m.joint_limit_lower, &m.joint_limit_upper,
                                 &m.joint_axis};
  covered_.resize(std::size(arrays));
  bool same = true;
  for (size_t i = 0; i < std::size(arrays); ++i)
    same = same && (covered_[i].matches(*arrays[i]) ||
                    // On devices, an array that another library may write is not read again in
                    // every step.
                    (!m.device().is_cpu() && arrays[i]->range() != nullptr &&
                     arrays[i]->range()->writable_export()));
  if (same) return;
  const UntrackedScope untracked;
  check_covered(m, solver);
  const std::vector<float> act = joint_act.to_host();
  for (size_t k = 0; k < act.size(); ++k)
    require(act[k] == 0.0f, ErrorKind::NotImplemented, solver, ": joint_act[", k,
            "]: expected 0 (there are no actuators; joint_f takes forces), got ", act[k]);
  for (size_t i = 0; i < std::size(arrays); ++i) covered_[i].set(*arrays[i]);
}

// Returns the longest stable step (s) of one joint's attachment spring, in the stiffest direction
// for either body alone. A longer step diverges regardless of the rest of the model. Infinite: the
// joint has no constrained direction.
static float joint_stable_dt(const HostJoints& m, size_t joint, const JointAttachOptions& attach) {
  float longest = std::numeric_limits<float>::infinity();
  const JointType type = m.type_of(joint);
  if (joint_traits(type).constraint != JointConstraint::AXES) return longest;
  const Vec2i dims = m.dims[joint];
  const Transformf frames[2] = {m.frame[0][joint], m.frame[1][joint]};
  const int32_t bodies[2] = {m.parent[joint], m.child[joint]};
  for (int side = 0; side < 2; ++side) {
    // Each body alone, in its own axes. Both bodies together are not more stable than one.
    const Mobility body = mobility(m, bodies[side]);
    if (bodies[side] < 0 || body.linear == 0.0f) continue;
    if (dims.x == 0) {
      const Vec3f arm = frames[side].p - m.com[static_cast<size_t>(bodies[side])];
      longest = std::min(
          longest, stable_dt(largest_along(mobility_at(body, arm), {}), attach.ke, attach.kd));
    } else if (dims.x < 3) {
      longest = std::min(longest, stable_dt(body.linear, attach.ke, attach.kd));
    }
    if (dims.y > 1) continue;
    Vec3f axis{};
    if (dims.y == 1)
      axis = math::rotate(frames[side].q, m.axis[static_cast<size_t>(m.qd_start[joint] + dims.x)]);
    longest = std::min(longest,
                       stable_dt(largest_along(body.angular, axis), attach.ke, 0.01f * attach.kd));
  }
  return longest;
}

void JointForces::find_sides(const HostJoints& m, int32_t body_count) {
  bodies_.assign(2 * m.type.size(), -1);
  for (size_t j = 0; j < m.type.size(); ++j) {
    if (m.enabled[j] == 0) continue;
    bodies_[2 * j] =
        joint_traits(m.type_of(j)).constraint == JointConstraint::NONE ? -1 : m.parent[j];
    bodies_[2 * j + 1] = m.child[j];
  }
  sides_.build(bodies_, body_count);
  wrenches_.assign(bodies_.size(), {});
}

void JointForces::prepare(const Model& m, const JointAttachOptions& attach, float dt) {
  if (m.joint_count() == 0) return;
  const bool known = enabled_.matches(m.joint_enabled) && mass_.matches(m.body_mass) &&
                     inertia_.matches(m.body_inertia) && flags_.matches(m.body_flags);
  if (!known) {
    enabled_.reset();
    const HostJoints joints(m);
    find_sides(joints, m.body_count());
    stable_dt_ = std::numeric_limits<float>::infinity();
    for (size_t j = 0; j < joints.type.size(); ++j) {
      if (joints.enabled[j] == 0) continue;
      const float limit = joint_stable_dt(joints, j, attach);
      if (limit < stable_dt_) unstable_joint_ = static_cast<int32_t>(j);
      stable_dt_ = std::min(stable_dt_, limit);
    }
    enabled_.set(m.joint_enabled);
    mass_.set(m.body_mass);
    inertia_.set(m.body_inertia);
    flags_.set(m.body_flags);
  }
  require(dt <= stable_dt_, ErrorKind::Value, "step: dt: expected at most ", stable_dt_,
          " s: above it joint ", unstable_joint_, " diverges with joint_attach_ke ", attach.ke,
          " and the mass and inertia of its bodies; lower the one or the other, got ", dt);
}

void JointForces::evaluate(const Model& m, const SimState& state, const Control* control,
                           const JointAttachOptions& options) {
  if (m.joint_count() == 0) return;
  const DofArrays dofs(m, control);
  const Transformf *const q = state.body_q.data(), *const x_p = m.joint_X_p.data(),
                          *const x_c = m.joint_X_c.data();
  const SpatialVectorf* const qd = state.body_qd.data();
  const Vec3f* const com = m.body_com.data();
  const int32_t *const parent = m.joint_parent.data(), *const child = m.joint_child.data(),
                       *const q_start = m.joint_q_start.data(),
                       *const qd_start = m.joint_qd_start.data();
  const Vec2i* const dims = m.joint_dof_dim.data();
  const JointAttach<float> attach = {options.ke, options.kd};
  const auto body = [&](int32_t b) {
    return b < 0 ? JointBody<float>{} : JointBody<float>{q[b], qd[b], com[b]};
  };
  for_chunks(m.joint_count(), kJointChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t j = begin; j < end; ++j) {
      const size_t first = 2 * static_cast<size_t>(j);
      if (bodies_[first + 1] < 0) continue;  // the joint is disabled
      const JointType type = type_of(m, static_cast<int32_t>(j));
      const JointConstraint constraint = joint_traits(type).constraint;
      JointWrench<float> wrench;
      JointDof<float> d[6];
      const int32_t count = dims[j].x + dims[j].y;
      for (int32_t k = 0; k < count; ++k)
        d[k] = dofs.at(qd_start[j] + k, has_axes(type) ? q_start[j] + k : -1);
      if (constraint != JointConstraint::NONE) {
        const JointFrames<float> frames =
            joint_frames(body(parent[j]), body(child[j]), x_p[j], x_c[j]);
        wrench = constraint == JointConstraint::DISTANCE
                     ? distance_joint_wrench(frames, d[0].limit)
                     : penalty_joint_wrench(frames, d, dims[j].x, dims[j].y,
                                            quaternion_at(type) == 0, attach);
      }
      // The wrench of joint_f acts about the child's center of mass, in the world frame.
      if (has_pose(type))
        wrench.child = wrench.child + SpatialVectorf{{d[0].force, d[1].force, d[2].force},
                                                     {d[3].force, d[4].force, d[5].force}};
      wrenches_[first] = wrench.parent;
      wrenches_[first + 1] = wrench.child;
    }
  });
}

SpatialVectorf JointForces::add(int64_t body, SpatialVectorf wrench) const {
  for (const int32_t side : sides_.items(body))
    wrench = wrench + wrenches_[static_cast<size_t>(side)];
  return wrench;
}

}  // namespace novaphy
