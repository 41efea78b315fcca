#include "novaphy/diff/planar_arm.h"

#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/diff_solver_base.h"
#include "novaphy/math/functions.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

using nova::Tensor;

constexpr const char* kRecorder = "record_planar_2r_featherstone_step";

// The force of a limit (N m), the limit's part of M's diagonal, and the derivatives by q and v.
struct Limit {
  float force = 0.0f, diagonal = 0.0f, by_q = 0.0f, by_v = 0.0f;
};

// The constants of the closed form.
struct Arm {
  float c1, l, tip, base_x, base_z;  // m
  float k, a, b;                     // kg m^2, N m, N m
  float i11, i12, i22;               // constant terms of M, without cos q2
  float lower[2], upper[2], ke[2], kd[2];
};

struct ArmStep {
  float m11, m12, m22;
  float acceleration[2], q[2], v[2];
  Limit limit[2];
};

Arm read_arm(const Model& m) {
  const float* mass = m.body_mass.data();
  const Mat33f* inertia = m.body_inertia.data();
  const Transformf *x_p = m.joint_X_p.data(), *x_c = m.joint_X_c.data();
  const float* armature = m.joint_armature.data();
  const int32_t link[2] = {m.joint_child.data()[0], m.joint_child.data()[1]};
  const float m1 = mass[link[0]], m2 = mass[link[1]];
  const float c2 = -x_c[1].p.x, g = -m.gravity.data()[0].z;
  Arm arm{};
  arm.c1 = -x_c[0].p.x;
  arm.l = x_p[1].p.x + arm.c1;
  arm.tip = 2.0f * c2;
  arm.base_x = x_p[0].p.x;
  arm.base_z = x_p[0].p.z;
  arm.k = m2 * arm.l * c2;
  arm.a = (m1 * arm.c1 + m2 * arm.l) * g;
  arm.b = m2 * c2 * g;
  arm.i12 = inertia[link[1]].m[1][1] + m2 * c2 * c2;
  arm.i11 =
      inertia[link[0]].m[1][1] + m1 * arm.c1 * arm.c1 + m2 * arm.l * arm.l + arm.i12 + armature[0];
  arm.i22 = arm.i12 + armature[1];
  for (int j = 0; j < 2; ++j) {
    arm.lower[j] = m.joint_limit_lower.data()[j];
    arm.upper[j] = m.joint_limit_upper.data()[j];
    arm.ke[j] = m.joint_limit_ke.data()[j];
    arm.kd[j] = m.joint_limit_kd.data()[j];
  }
  return arm;
}

Limit limit_force(const Arm& arm, int j, float q, float v, float dt) {
  const bool below = q<arm.lower[j], above = q> arm.upper[j];
  if (!below && !above) return {};
  const float bound = below ? arm.lower[j] : arm.upper[j], ke = arm.ke[j], kd = arm.kd[j];
  return {ke * (bound - q - dt * v) - kd * v, dt * kd + dt * dt * ke, -ke, -(kd + dt * ke)};
}

ArmStep step_arm(const Arm& arm, const float* q, const float* v, float dt, float damping) {
  ArmStep s{};
  const float cos2 = math::cos(q[1]), sin2 = math::sin(q[1]);
  for (int j = 0; j < 2; ++j) s.limit[j] = limit_force(arm, j, q[j], v[j], dt);
  s.m11 = arm.i11 + 2.0f * arm.k * cos2 + s.limit[0].diagonal;
  s.m12 = arm.i12 + arm.k * cos2;
  s.m22 = arm.i22 + s.limit[1].diagonal;
  const float g2 = -arm.b * math::cos(q[0] + q[1]), g1 = g2 - arm.a * math::cos(q[0]);
  const float h1 = -arm.k * sin2 * v[1] * (2.0f * v[0] + v[1]);
  const float h2 = arm.k * sin2 * v[0] * v[0];
  const float r1 = s.limit[0].force - h1 - g1, r2 = s.limit[1].force - h2 - g2;
  const float inverse = 1.0f / (s.m11 * s.m22 - s.m12 * s.m12);
  s.acceleration[0] = (s.m22 * r1 - s.m12 * r2) * inverse;
  s.acceleration[1] = (s.m11 * r2 - s.m12 * r1) * inverse;
  for (int j = 0; j < 2; ++j) {
    const float u = v[j] + dt * s.acceleration[j];
    s.q[j] = q[j] + dt * u;
    s.v[j] = u * (1.0f - damping * dt);
  }
  return s;
}

// Computes the gradients of q and v from the gradients of q' and v' (planar_arm.h).
void step_arm_vjp(const Arm& arm, const float* q, const float* v, float dt, float damping,
                  const float* q_out, const float* v_out, float* q_in, float* v_in) {
  const ArmStep s = step_arm(arm, q, v, dt, damping);
  float u[2];
  for (int j = 0; j < 2; ++j) u[j] = dt * q_out[j] + (1.0f - damping * dt) * v_out[j];
  const float inverse = dt / (s.m11 * s.m22 - s.m12 * s.m12);
  const float l1 = (s.m22 * u[0] - s.m12 * u[1]) * inverse;
  const float l2 = (s.m11 * u[1] - s.m12 * u[0]) * inverse;
  const float sin1 = math::sin(q[0]), sin12 = math::sin(q[0] + q[1]), b12 = arm.b * sin12;
  const float ks = arm.k * math::sin(q[1]), kc = arm.k * math::cos(q[1]);
  const float a1 = s.acceleration[0], a2 = s.acceleration[1];
  q_in[0] = q_out[0] - l1 * (arm.a * sin1 + b12) - l2 * b12 + s.limit[0].by_q * l1;
  q_in[1] = q_out[1] - (l1 + l2) * b12 + s.limit[1].by_q * l2 -
            (l1 * (-ks * (2.0f * a1 + a2) - kc * v[1] * (2.0f * v[0] + v[1])) +
             l2 * (-ks * a1 + kc * v[0] * v[0]));
  v_in[0] = u[0] + 2.0f * ks * v[1] * l1 - 2.0f * ks * v[0] * l2 + s.limit[0].by_v * l1;
  v_in[1] = u[1] + 2.0f * ks * (v[0] + v[1]) * l1 + s.limit[1].by_v * l2;
}

bool is_identity(const Quatf& q) { return q.x == 0.0f && q.y == 0.0f && q.z == 0.0f; }

// Throws ErrorKind::Runtime with the first condition of record_planar_2r_featherstone_step that the
// model does not meet.
void check_arm(const Model& m, const char* function) {
  const auto need = [&](bool met, const char* condition) {
    require(met, ErrorKind::Runtime, function, ": expected ", condition);
  };
  need(m.device().is_cpu(), "a model on the cpu");
  need(m.articulation_count() == 1, "one articulation");
  need(m.joint_count() == 2 && m.body_count() == 2, "two joints and two bodies");
  const int32_t *type = m.joint_type.data(), *parent = m.joint_parent.data(),
                *child = m.joint_child.data();
  for (int j = 0; j < 2; ++j) {
    need(type[j] == static_cast<int32_t>(JointType::REVOLUTE), "REVOLUTE joints");
    need(m.joint_enabled.data()[j] != 0, "joints that are enabled");
    need(m.joint_mimic.data()[j] < 0, "joints that follow no other");
  }
  need(parent[0] == -1, "the first link on the world");
  need(parent[1] == child[0], "the second link on the first");
  for (int j = 0; j < 2; ++j) {
    const Vec3f axis = m.joint_axis.data()[j];
    need(axis.x == 0.0f && axis.y == 1.0f && axis.z == 0.0f, "axes of exactly +Y");
    const Transformf p = m.joint_X_p.data()[j], c = m.joint_X_c.data()[j];
    need(is_identity(p.q) && is_identity(c.q), "joint frames without rotation");
    need(j == 0 || (p.p.y == 0.0f && p.p.z == 0.0f), "the second joint on the first link's x axis");
    need(c.p.y == 0.0f && c.p.z == 0.0f, "joints on the x axes of their links");
    const Vec3f com = m.body_com.data()[j];
    need(com.x == 0.0f && com.y == 0.0f && com.z == 0.0f,
         "centers of mass at the origins of the bodies (body_com 0)");
    need(!has_flag(m.body_flags.data()[j], BodyFlags::KINEMATIC), "bodies that are dynamic");
    need(m.body_mass.data()[j] > 0.0f, "bodies with mass");
  }
  const Vec3f g = m.gravity.data()[0];
  need(g.x == 0.0f && g.y == 0.0f && g.z <= 0.0f, "gravity along -Z");
}

void check_zero(const char* name, const DeviceArray<float>& array) {
  for (size_t i = 0; i < array.rows(); ++i)
    require(array.data()[i] == 0.0f, ErrorKind::Runtime, kRecorder, ": expected ", name, " 0, got ",
            array.data()[i], " at ", i);
}

void check_forces(const Model& m, const SimState& state, const Control* control) {
  check_zero("joint_target_ke", m.joint_target_ke);
  check_zero("joint_target_kd", m.joint_target_kd);
  check_zero("joint_damping", m.joint_damping);
  check_zero("joint_friction", m.joint_friction);
  check_zero("joint_f", control ? control->joint_f : m.joint_f);
  check_zero("joint_act", control ? control->joint_act : m.joint_act);
  const auto* f = reinterpret_cast<const float*>(state.body_f.data());
  for (size_t i = 0; i < 6 * state.body_f.rows(); ++i)
    require(f[i] == 0.0f, ErrorKind::Runtime, kRecorder, ": expected body_f 0, got ", f[i],
            " at body ", i / 6);
}

// Refuses gradients of other inputs: the closed form has derivatives with respect to q and qd
// alone.
void check_gradients(const Model& m, const SimState& state, const Control* control) {
  check_no_gradient(kRecorder, {{"gravity", m.gravity},
                                {"body_mass", m.body_mass},
                                {"body_com", m.body_com},
                                {"body_inertia", m.body_inertia},
                                {"joint_X_p", m.joint_X_p},
                                {"joint_X_c", m.joint_X_c},
                                {"joint_axis", m.joint_axis},
                                {"joint_armature", m.joint_armature},
                                {"joint_damping", m.joint_damping},
                                {"joint_friction", m.joint_friction},
                                {"joint_target_ke", m.joint_target_ke},
                                {"joint_target_kd", m.joint_target_kd},
                                {"joint_limit_lower", m.joint_limit_lower},
                                {"joint_limit_upper", m.joint_limit_upper},
                                {"joint_limit_ke", m.joint_limit_ke},
                                {"joint_limit_kd", m.joint_limit_kd}});
  check_no_gradient(kRecorder,
                    {{"joint_f", control ? control->joint_f : m.joint_f},
                     {"joint_act", control ? control->joint_act : m.joint_act},
                     {"body_f", state.body_f}},
                    "");
}

void check_pair(const char* function, const char* name, const Tensor& tensor) {
  require(tensor.defined() && tensor.dtype() == nova::DType::F32, ErrorKind::Type, function, ", ",
          name, ": expected a float32 tensor");
  require(tensor.size() == 2 && tensor.device().is_cpu(), ErrorKind::Value, function, ", ", name,
          ": expected {2} on the cpu, got ", nova::shape_str(tensor.shape()), " on ",
          tensor.device().str());
}

void check_result(const char* name, const float* got, const float* expected) {
  for (int j = 0; j < 2; ++j) {
    const float tolerance = 5e-6f + 2e-6f * std::abs(expected[j]);
    require(std::abs(got[j] - expected[j]) <= tolerance, ErrorKind::Runtime, kRecorder, ", ", name,
            "[", j, "]: expected what the closed form gives, ", expected[j], ", got ", got[j],
            ": a clamp, another angular_damping or solver option, or not what "
            "SolverFeatherstone.step has just written");
  }
}

}  // namespace

void record_planar_2r_featherstone_step(const Model& model, const SimState& state_in,
                                        const Control* control, const Tensor& q, const Tensor& qd,
                                        const Tensor& q_out, const Tensor& qd_out, float dt,
                                        float angular_damping) {
  check_arm(model, kRecorder);
  check_forces(model, state_in, control);
  require(std::isfinite(dt) && dt > 0.0f, ErrorKind::Value, kRecorder,
          ", dt: expected a finite number > 0, got ", dt);
  check_pair(kRecorder, "q", q);
  check_pair(kRecorder, "qd", qd);
  check_pair(kRecorder, "q_out", q_out);
  check_pair(kRecorder, "qd_out", qd_out);
  require(q.range() == state_in.joint_q.range() && qd.range() == state_in.joint_qd.range(),
          ErrorKind::Runtime, kRecorder,
          ": expected q and qd to be state_in's joint_q and joint_qd");
  const Arm arm = read_arm(model);
  const ArmStep s = step_arm(arm, q.data<float>(), qd.data<float>(), dt, angular_damping);
  check_result("q_out", q_out.data<float>(), s.q);
  check_result("qd_out", qd_out.data<float>(), s.v);
  nova::Tape* const tape = nova::Tape::active();
  if (tape == nullptr) return;
  check_gradients(model, state_in, control);
  make_leaves(state_in);
  tape->record_custom(
      "planar_2r_featherstone_step", {q, qd}, {q_out, qd_out}, [=](const std::vector<Tensor>& g) {
        const float zero[2] = {0.0f, 0.0f};
        float q_in[2], v_in[2];
        step_arm_vjp(arm, q.data<float>(), qd.data<float>(), dt, angular_damping,
                     g[0].defined() ? g[0].data<float>() : zero,
                     g[1].defined() ? g[1].data<float>() : zero, q_in, v_in);
        return std::vector<Tensor>{Tensor::from_host(std::span<const float>(q_in), q.shape()),
                                   Tensor::from_host(std::span<const float>(v_in), qd.shape())};
      });
}

Tensor planar_2r_tip_loss(const Model& model, const Tensor& q, float target_x, float target_z) {
  constexpr const char* kLoss = "planar_2r_tip_loss";
  check_arm(model, kLoss);
  check_pair(kLoss, "q", q);
  require(std::isfinite(target_x) && std::isfinite(target_z), ErrorKind::Value, kLoss,
          ": expected a finite target, got (", target_x, ", ", target_z, ")");
  const Arm arm = read_arm(model);
  struct Tip {
    float dx, dz, x12, z12, x1, z1;  // tip minus target; vector of the second link; of the first
                                     // link
  };
  const auto tip = [=](const float* x) {
    const float q12 = x[0] + x[1];
    const float x1 = arm.l * math::cos(x[0]), z1 = -arm.l * math::sin(x[0]);
    const float x12 = arm.tip * math::cos(q12), z12 = -arm.tip * math::sin(q12);
    return Tip{
        arm.base_x + x1 + x12 - target_x, arm.base_z + z1 + z12 - target_z, x12, z12, x1, z1};
  };
  const Tip t = tip(q.data<float>());
  const float value = t.dx * t.dx + t.dz * t.dz;
  const Tensor loss = Tensor::from_host(std::span<const float>(&value, 1), {1});
  if (nova::Tape* tape = nova::Tape::active())
    tape->record_custom("planar_2r_tip_loss", {q}, {loss}, [=](const std::vector<Tensor>& g) {
      const Tip at = tip(q.data<float>());
      const float seed = g[0].data<float>()[0];
      // The derivative of a vector (x, z) with respect to a rotation about +Y is (z, -x).
      const float second = at.dx * at.z12 - at.dz * at.x12;
      const float first = second + (at.dx * at.z1 - at.dz * at.x1);
      const float back[2] = {2.0f * seed * first, 2.0f * seed * second};
      return std::vector<Tensor>{Tensor::from_host(std::span<const float>(back), q.shape())};
    });
  return loss;
}

}  // namespace novaphy::diff
