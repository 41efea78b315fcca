#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tree_reference.h"

namespace novaphy {
namespace {

using articulation::Tree;
using articulation::Workspace;
using testing::load_tree;
using testing::Npz;
using testing::sample;
using testing::TestTree;

const Npz& reference() {
  static const Npz file(NOVAPHY_GOLDEN_DIR "/pinocchio_trees.npz");
  return file;
}
std::vector<std::string> names() {
  std::vector<std::string> all = {"fr3", "humanoid"};
  for (int i = 0; i < 20; ++i) all.push_back((i < 10 ? "tree0" : "tree") + std::to_string(i));
  return all;
}

// max |x - expected| / max |expected|
template <class T>
double difference(const std::vector<T>& x, const std::vector<double>& expected) {
  double worst = 0.0, scale = 0.0;
  for (size_t i = 0; i < x.size(); ++i) {
    worst = std::fmax(worst, std::abs(static_cast<double>(x[i]) - expected[i]));
    scale = std::fmax(scale, std::abs(expected[i]));
  }
  EXPECT_EQ(x.size(), expected.size());
  return scale == 0.0 ? worst : worst / scale;
}

template <class T>
struct Dynamics {
  std::vector<T> tau, matrix, qdd, dtau_dq, dtau_dqd, dqdd_dq, dqdd_dqd, inverse;
};

template <class T>
std::vector<T> full(const std::vector<T>& lower, size_t n) {
  std::vector<T> matrix = lower;
  for (size_t i = 0; i < n; ++i)
    for (size_t j = i + 1; j < n; ++j) matrix[i * n + j] = matrix[j * n + i];
  return matrix;
}

template <class T>
void derivatives(TestTree<T>& store, Workspace<T>& ws, const std::vector<T>& qd,
                 const std::vector<T>& qdd, std::vector<T>& dq, std::vector<T>& dqd) {
  const Tree<T> tree = store.view();
  std::vector<T> tau(qd.size());
  articulation::inverse_dynamics(tree, qd.data(), qdd.data(), ws, tau.data());
  articulation::composite_inertias(tree, ws);
  articulation::DerivativeWorkspace<T> memory{store.motions.data(), store.biases.data()};
  dq.resize(qd.size() * qd.size());
  dqd.resize(qd.size() * qd.size());
  articulation::inverse_dynamics_derivatives(tree, qd.data(), qdd.data(), ws, memory, dq.data(),
                                             dqd.data());
}

template <class T>
Dynamics<T> evaluate(const std::string& name, size_t row, int32_t joints_in_a_row) {
  const Npz& file = reference();
  TestTree<T> store = load_tree<T>(file, name);
  store.joints_in_a_row = joints_in_a_row;
  const Tree<T> tree = store.view();
  Workspace<T> ws = store.workspace();
  const auto n = static_cast<size_t>(store.dofs);
  const auto q = sample<T>(file, name + "_q", row), qd = sample<T>(file, name + "_qd", row),
             qdd = sample<T>(file, name + "_qdd", row),
             torque = sample<T>(file, name + "_fd_tau", row);
  Dynamics<T> d;
  d.tau.resize(n);
  articulation::kinematics(tree, q.data(), ws);
  articulation::inverse_dynamics(tree, qd.data(), qdd.data(), ws, d.tau.data());
  for (size_t i = 0; i < n; ++i) d.tau[i] += store.armature[i] * qdd[i];
  derivatives(store, ws, qd, qdd, d.dtau_dq, d.dtau_dqd);

  articulation::mass_matrix(tree, ws);
  for (size_t i = 0; i < n; ++i) ws.matrix[i * n + i] += store.armature[i];
  d.matrix = full(std::vector<T>(ws.matrix, ws.matrix + n * n), n);
  articulation::clear_wrenches(tree, ws);
  articulation::bias_forces(tree, qd.data(), ws);
  for (size_t i = 0; i < n; ++i) {
    ws.rhs[i] = torque[i] - ws.bias[i];
    ws.diagonal[i] = store.armature[i];
  }
  EXPECT_EQ(articulation::factor(tree, q.data(), ws), -1);
  articulation::find_accelerations(tree, qd.data(), ws);
  d.qdd.assign(ws.qdd, ws.qdd + n);
  derivatives(store, ws, qd, d.qdd, d.dqdd_dq, d.dqdd_dqd);
  d.inverse.resize(n * n);
  articulation::forward_dynamics_derivatives(tree, ws, d.dqdd_dq.data(), d.dqdd_dqd.data(),
                                             d.inverse.data());
  return d;
}

size_t rows_of(const std::string& name) { return reference()[name + "_q"].shape[0]; }

// With both factorizations.
TEST(Articulation, EqualsPinocchioInDoublePrecision) {
  for (const std::string& name : names())
    for (size_t row = 0; row < 2 * rows_of(name); ++row) {
      const Dynamics<double> d = evaluate<double>(
          name, row / 2, row % 2 ? TestTree<double>::kLong : TestTree<double>::kShort);
      const auto check = [&](const std::vector<double>& x, const char* key, double tolerance) {
        EXPECT_LT(difference(x, sample<double>(reference(), name + key, row / 2)), tolerance)
            << name << key << " " << row;
      };
      check(d.tau, "_tau", 1e-10);
      check(d.matrix, "_H", 1e-10);
      check(d.qdd, "_fd_qdd", 1e-10);
      check(d.dtau_dq, "_dtau_dq", 1e-10);
      check(d.dtau_dqd, "_dtau_dqd", 1e-10);
      check(d.dqdd_dq, "_dqdd_dq", 1e-9);
      check(d.dqdd_dqd, "_dqdd_dqd", 1e-9);
      check(d.inverse, "_Minv", 1e-10);
    }
}

TEST(Articulation, EqualsPinocchioInSinglePrecision) {
  for (const std::string& name : names())
    for (size_t row = 0; row < 2 * rows_of(name); ++row) {
      const bool by_links = row % 2 != 0;
      const Dynamics<float> d = evaluate<float>(
          name, row / 2, by_links ? TestTree<float>::kLong : TestTree<float>::kShort);
      const auto check = [&](const std::vector<float>& x, const char* key, double tolerance) {
        EXPECT_LT(difference(x, sample<double>(reference(), name + key, row / 2)), tolerance)
            << name << key << " " << row;
      };
      check(d.tau, "_tau", 1e-5);
      check(d.matrix, "_H", 1e-5);
      check(d.dtau_dq, "_dtau_dq", 1e-5);
      check(d.dtau_dqd, "_dtau_dqd", 1e-5);
      // The error of accelerations is bounded by the condition number of H. Articulated bodies need
      // no H.
      check(d.qdd, "_fd_qdd", by_links ? 2e-6 : name == "fr3" ? 2e-6 * 1.7e4 : 2e-4);
    }
}

// Random links. Every fourth one hangs on one of the six before it. All T get the same numbers.
template <class T>
struct Chain {
  TestTree<T> tree;
  std::vector<T> q, qd;
  Chain(int count, int32_t joints_in_a_row, bool floats) {
    using articulation::LinkJoint;
    std::mt19937 random(static_cast<uint32_t>(count));
    std::normal_distribution<float> normal;
    const auto number = [&](float s) { return T(s * normal(random)); };
    const auto vector = [&](float s) { return Vec3<T>{number(s), number(s), number(s)}; };
    const auto turn = [&] {
      const Quat<T> r = {number(1), number(1), number(1), number(1)};
      return articulation::scaled(r, T(1) / articulation::quat_length(r));
    };
    tree.joints_in_a_row = joints_in_a_row;
    for (int i = 0; i < count; ++i) {
      const Vec3<T> axis = vector(1), h = vector(0.01f);
      const T m = T(0.05f) + std::abs(number(0.2f)), one = T(1e-4f);
      const LinkJoint joint = i == 0 && floats ? LinkJoint::Free
                              : i % 7 == 3     ? LinkJoint::Ball
                              : i % 7 == 5     ? LinkJoint::Prismatic
                                               : LinkJoint::Revolute;
      tree.add(joint, i - 1 - (i % 4 == 3 && i > 6 ? i % 6 : 0), {vector(0.05f), turn()},
               {vector(0.03f), turn()}, axis / articulation::square_root(math::dot(axis, axis)), m,
               vector(0.03f),
               {{{one + h.x * h.x, h.x * h.y, h.x * h.z},
                 {h.x * h.y, one + h.y * h.y, h.y * h.z},
                 {h.x * h.z, h.y * h.z, one + h.z * h.z}}});
      if (joint == LinkJoint::Free)
        for (const T x : {number(1), number(1), number(1)}) q.push_back(x);
      const Quat<T> r = turn();
      if (tree.links.back().dofs > 1)
        for (const T x : {r.x, r.y, r.z, r.w}) q.push_back(x);
      else
        q.push_back(number(0.7f));
    }
    for (int k = 0; k < tree.dofs; ++k) qd.push_back(number(1));
  }
};
template <class T>
struct ChainDynamics {
  std::vector<T> qdd, solved;
  ChainDynamics(Chain<T> c) {
    const Tree<T> tree = c.tree.view();
    Workspace<T> ws = c.tree.workspace();
    articulation::kinematics(tree, c.q.data(), ws);
    articulation::clear_wrenches(tree, ws);
    articulation::bias_forces(tree, c.qd.data(), ws);
    for (int32_t k = 0; k < tree.dof_count; ++k) {
      ws.rhs[k] = T(0.1f) - ws.bias[k];
      ws.diagonal[k] = T(0);
    }
    EXPECT_EQ(articulation::factor(tree, c.q.data(), ws), -1);
    articulation::find_accelerations(tree, c.qd.data(), ws);
    qdd.assign(ws.qdd, ws.qdd + tree.dof_count);
    solved = c.qd;
    articulation::solve(tree, ws, solved.data());
  }
};

TEST(Articulation, LongTreesKeepTheirDigitsInSinglePrecision) {
  for (const int count : {10, 30, 100, 200})
    for (const bool floats : {false, true}) {
      const ChainDynamics<double> expected({count, TestTree<double>::kShort, floats});
      const ChainDynamics<float> d({count, TestTree<float>::kLong, floats});
      EXPECT_LT(difference(d.qdd, expected.qdd), 2e-6) << count;
      EXPECT_LT(difference(d.solved, expected.solved), 1e-4) << count;
    }
}

}  // namespace
}  // namespace novaphy
