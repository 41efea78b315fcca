// eval_fk and eval_ik: Pinocchio's kinetic energy, finite differences, round trips.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;

Mat33f diagonal(float x, float y, float z) {
  return {{{x, 0.0f, 0.0f}, {0.0f, y, 0.0f}, {0.0f, 0.0f, z}}};
}

class Random {
 public:
  float operator()() { return number_(engine_); }
  Vec3f vec3() { return {(*this)(), (*this)(), (*this)()}; }
  Quatf rotation() {
    const Vec3f v = vec3();
    const Quatf q = {v.x, v.y, v.z, 1.2f + (*this)()};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {q.x / l, q.y / l, q.z / l, q.w / l};
  }
  Transformf pose() { return {vec3(), rotation()}; }

 private:
  std::mt19937 engine_{7};
  std::uniform_real_distribution<float> number_{-1.0f, 1.0f};
};

// A joint of each type, two D6, random frames and centers of mass.
std::shared_ptr<Model> chain() {
  Random random;
  ModelBuilder b;
  for (int k = 0; k < 9; ++k)
    b.add_link({.com = random.vec3(),
                .mass = 1.0f + 0.1f * static_cast<float>(k),
                .inertia = diagonal(0.1f, 0.2f, 0.25f)});
  const auto dof = [](float x, float y, float z) { return JointDofConfig{.axis = {x, y, z}}; };
  const auto args = [&] {
    return JointArgs{.parent_xform = random.pose(), .child_xform = random.pose()};
  };
  b.add_joint_free(0, {.parent_xform = random.pose(), .child_xform = random.pose()});
  JointArgs hinge = args();
  hinge.angular_axes = {dof(1.0f, 2.0f, 0.5f)};
  b.add_joint(JointType::REVOLUTE, 0, 1, hinge);
  JointArgs slide = args();
  slide.linear_axes = {dof(-1.0f, 0.5f, 2.0f)};
  b.add_joint(JointType::PRISMATIC, 1, 2, slide);
  b.add_joint(JointType::BALL, 2, 3, args());
  b.add_joint(JointType::FIXED, 3, 4, args());
  JointArgs three = args();  // left-handed
  three.linear_axes = {dof(0.0f, 1.0f, 0.0f), dof(1.0f, 0.0f, 1.0f)};
  three.angular_axes = {dof(0.0f, 1.0f, 0.0f), dof(1.0f, 0.0f, 0.0f), dof(0.0f, 0.0f, 1.0f)};
  b.add_joint(JointType::D6, 4, 5, three);
  JointArgs two = args();
  two.angular_axes = {dof(0.0f, 1.0f, 1.0f), dof(1.0f, 0.0f, 0.0f)};
  b.add_joint(JointType::D6, 5, 6, two);
  b.add_joint_free(7, {.parent_xform = random.pose(), .parent = 1});
  b.add_joint(JointType::DISTANCE, 7, 8, args());
  std::vector<int32_t> joints(9);
  std::iota(joints.begin(), joints.end(), 0);
  b.add_articulation(joints);
  Random state;
  for (float& v : b.joint_qd) v = state();
  const auto start = b.finalize()->joint_q_start.to_host();
  const auto type = b.finalize()->joint_type.to_host();
  for (size_t j = 0; j < type.size(); ++j) {
    const bool ball = type[j] == static_cast<int32_t>(JointType::BALL);
    const bool six = start[j + 1] - start[j] == 7;
    const auto first = static_cast<size_t>(start[j]);
    if (!ball)
      for (size_t k = first; k < static_cast<size_t>(start[j + 1]) - (six ? 4 : 0); ++k)
        b.joint_q[k] = state();
    if (!ball && !six) continue;
    const Quatf q = state.rotation();
    const std::array values = {q.x, q.y, q.z, q.w};
    std::copy(values.begin(), values.end(), b.joint_q.begin() + start[j] + (six ? 3 : 0));
  }
  return b.finalize();
}

TEST(JointCoordinates, TheWayBackGivesTheCoordinates) {
  const auto model = chain();
  SimState state = model->state();
  eval_fk(*model, model->joint_q, model->joint_qd, state);
  DeviceArray<float> q(model->joint_q.rows(), model->device()),
      qd(model->joint_qd.rows(), model->device());
  eval_ik(*model, state, q, qd);
  const auto expected_q = model->joint_q.to_host(), found_q = q.to_host();
  const auto start = model->joint_q_start.to_host();
  for (size_t j = 0; j + 1 < start.size(); ++j) {
    // A quaternion and its negative are one rotation.
    const auto last = static_cast<size_t>(start[j + 1]);
    const int32_t coords = start[j + 1] - start[j];
    const bool quaternion = coords == 7 || coords == 4;
    const float side = quaternion && found_q[last - 1] * expected_q[last - 1] < 0.0f ? -1.0f : 1.0f;
    for (auto k = static_cast<size_t>(start[j]); k < last; ++k) {
      const bool turned = quaternion && k + 4 >= last;
      EXPECT_NEAR(found_q[k] * (turned ? side : 1.0f), expected_q[k], 2e-5f) << j << " " << k;
    }
  }
  const auto expected = model->joint_qd.to_host(), found = qd.to_host();
  for (size_t k = 0; k < found.size(); ++k) EXPECT_NEAR(found[k], expected[k], 1e-4f) << k;
  SimState again = model->state();
  eval_fk(*model, q, qd, again);
  const auto a = again.body_q.to_host(), b = state.body_q.to_host();
  for (size_t i = 0; i < a.size(); ++i) EXPECT_LT(math::length(a[i].p - b[i].p), 2e-5f) << i;
}

// The twists are the rates of the poses: central differences along qd.
TEST(JointCoordinates, TwistsAreTheRatesOfThePoses) {
  const auto model = chain();
  SimState state = model->state();
  eval_fk(*model, model->joint_q, model->joint_qd, state);
  constexpr float kStep = 2e-3f;
  const auto type = model->joint_type.to_host();
  const auto start = model->joint_q_start.to_host(), dof = model->joint_qd_start.to_host();
  // Coordinates a little later. A FREE joint's rate is that of its center of mass.
  const auto moved = [&](float h) {
    std::vector<float> q = model->joint_q.to_host();
    const auto qd = model->joint_qd.to_host();
    for (size_t j = 0; j < type.size(); ++j) {
      float* const c = &q[static_cast<size_t>(start[j])];
      const float* const v = qd.data() + dof[j];
      const int32_t coords = start[j + 1] - start[j];
      if (coords != 7 && coords != 4) {
        for (int32_t k = 0; k < coords; ++k) c[k] += h * v[k];
        continue;
      }
      const bool six = coords == 7;
      float* const r = c + (six ? 3 : 0);
      const float* const w = v + (six ? 3 : 0);
      const Quatf old = {r[0], r[1], r[2], r[3]};
      const float speed = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
      const float s = std::sin(0.5f * h * speed) / speed;
      const Quatf q1 =
          math::multiply({w[0] * s, w[1] * s, w[2] * s, std::cos(0.5f * h * speed)}, old);
      if (six) {
        const auto child = static_cast<size_t>(model->joint_child.to_host()[j]);
        const Transformf inverse = math::inverse(model->joint_X_c.to_host()[j]);
        const Vec3f com = math::transform_point(inverse, model->body_com.to_host()[child]);
        const Vec3f p = Vec3f{c[0], c[1], c[2]} + math::rotate(old, com) +
                        Vec3f{v[0], v[1], v[2]} * h - math::rotate(q1, com);
        c[0] = p.x;
        c[1] = p.y;
        c[2] = p.z;
      }
      r[0] = q1.x;
      r[1] = q1.y;
      r[2] = q1.z;
      r[3] = q1.w;
    }
    SimState at = model->state();
    eval_fk(*model, DeviceArray<float>::from_host(q, model->device()), model->joint_qd, at);
    return at.body_q.to_host();
  };
  const auto after = moved(kStep), before = moved(-kStep);
  const auto twist = state.body_qd.to_host();
  const auto com = model->body_com.to_host();
  for (size_t b = 0; b < twist.size(); ++b) {
    const Vec3f v =
        (math::transform_point(after[b], com[b]) - math::transform_point(before[b], com[b])) *
        (0.5f / kStep);
    const Quatf turn = math::multiply(after[b].q, math::conjugate(before[b].q));
    const float side = turn.w < 0.0f ? -1.0f : 1.0f;
    const Vec3f w = Vec3f{turn.x, turn.y, turn.z} * (side / kStep);
    EXPECT_LT(math::length(v - twist[b].linear), 5e-3f) << b;
    EXPECT_LT(math::length(w - twist[b].angular), 5e-3f) << b;
  }
}

// 1/2 qd^T H qd of Pinocchio is the kinetic energy of the bodies.
TEST(JointCoordinates, TheKineticEnergyIsPinocchios) {
  const Npz file = golden("pinocchio_trees.npz");
  for (int tree = 0; tree < 20; ++tree) {
    const std::string name = std::string(tree < 10 ? "tree0" : "tree") + std::to_string(tree) + "_";
    const auto numbers = [&](const char* what) {
      const auto values = file[name + what].as<double>();
      return std::vector<float>(values.begin(), values.end());
    };
    const auto type = file[name + "type"].as<int32_t>();
    const auto parent = file[name + "parent"].as<int32_t>();
    const auto axis = numbers("axis"), x_p = numbers("X_p"), x_c = numbers("X_c"),
               mass = numbers("mass"), com = numbers("com"), inertia = numbers("inertia"),
               armature = numbers("armature"), q = numbers("q"), qd = numbers("qd"),
               h = numbers("H");
    const auto pose = [](const std::vector<float>& x, size_t row) {
      const float* const v = &x[7 * row];
      return Transformf{{v[0], v[1], v[2]}, {v[3], v[4], v[5], v[6]}};
    };
    ModelBuilder b;
    std::vector<int32_t> joints;
    for (size_t j = 0; j < type.size(); ++j) {
      Mat33f i;
      for (size_t k = 0; k < 9; ++k) i.m[k / 3][k % 3] = inertia[9 * j + k];
      b.add_link(
          {.com = {com[3 * j], com[3 * j + 1], com[3 * j + 2]}, .mass = mass[j], .inertia = i});
    }
    for (size_t j = 0; j < type.size(); ++j) {
      JointArgs args{.parent_xform = pose(x_p, j), .child_xform = pose(x_c, j)};
      const JointDofConfig dof{.axis = {axis[3 * j], axis[3 * j + 1], axis[3 * j + 2]}};
      const auto of = static_cast<JointType>(type[j]);
      if (of == JointType::REVOLUTE) args.angular_axes = {dof};
      if (of == JointType::PRISMATIC) args.linear_axes = {dof};
      joints.push_back(b.add_joint(of, parent[j], static_cast<int32_t>(j), args));
    }
    b.add_articulation(joints);
    const auto model = b.finalize();
    const auto dofs = static_cast<size_t>(model->joint_dof_count());
    const auto coords = static_cast<size_t>(model->joint_coord_count());
    ASSERT_EQ(q.size() % coords, 0u);
    SimState state = model->state();
    state.joint_q.copy_from_host(std::span(q).first(coords));
    state.joint_qd.copy_from_host(std::span(qd).first(dofs));
    eval_fk(*model, state.joint_q, state.joint_qd, state);
    double expected = 0.0, energy = 0.0;
    for (size_t r = 0; r < dofs; ++r)
      for (size_t c = 0; c < dofs; ++c)
        expected += 0.5 * static_cast<double>(qd[r]) * qd[c] *
                    (h[r * dofs + c] - (r == c ? armature[r] : 0.0f));
    const auto poses = state.body_q.to_host();
    const auto twists = state.body_qd.to_host();
    const auto inertias = model->body_inertia.to_host();
    for (size_t i = 0; i < poses.size(); ++i) {
      const Vec3f w = math::rotate_inverse(poses[i].q, twists[i].angular);
      const float v[3] = {w.x, w.y, w.z};
      energy += 0.5 * static_cast<double>(mass[i]) * math::dot(twists[i].linear, twists[i].linear);
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
          energy += 0.5 * static_cast<double>(v[r]) * inertias[i].m[r][c] * v[c];
    }
    EXPECT_NEAR(energy, expected, 1e-5 * expected) << name;
  }
}

TEST(JointCoordinates, BadArgumentsAreRefused) {
  const auto model = chain(), other = chain();
  SimState state = model->state();
  EXPECT_ERROR(eval_fk(*model, model->joint_qd, model->joint_qd, state), ErrorKind::Value,
               "eval_fk: joint_q: expected");
  EXPECT_ERROR(eval_fk(*other, model->joint_q, model->joint_qd, state), ErrorKind::Value,
               "state: expected one of the model");
  std::vector<float> q = model->joint_q.to_host();
  for (size_t k = 3; k < 7; ++k) q[k] = 0.0f;
  const auto before = state.body_q.to_host();
  EXPECT_ERROR(
      eval_fk(*model, DeviceArray<float>::from_host(q, model->device()), model->joint_qd, state),
      ErrorKind::Value, "joint_q of joint 0: expected a quaternion that is not zero");
  EXPECT_TRUE(testing::same_bits(std::span<const Transformf>(before),
                                 std::span<const Transformf>(state.body_q.to_host())));
}

}  // namespace
}  // namespace novaphy
