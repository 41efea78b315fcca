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
Dynamics<T> evaluate(const std::string& name, size_t row) {
  const Npz& file = reference();
  TestTree<T> store = load_tree<T>(file, name);
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
  std::vector<T> bias(n);
  articulation::inverse_dynamics<T>(tree, qd.data(), nullptr, ws, bias.data());
  EXPECT_EQ(articulation::factor(tree, ws.matrix), -1);
  d.qdd = torque;
  for (size_t i = 0; i < n; ++i) d.qdd[i] -= bias[i];
  articulation::solve(tree, ws.matrix, d.qdd.data());
  derivatives(store, ws, qd, d.qdd, d.dqdd_dq, d.dqdd_dqd);
  d.inverse.resize(n * n);
  articulation::forward_dynamics_derivatives(tree, ws.matrix, d.dqdd_dq.data(), d.dqdd_dqd.data(),
                                             d.inverse.data());
  return d;
}

size_t rows_of(const std::string& name) { return reference()[name + "_q"].shape[0]; }

TEST(Articulation, EqualsPinocchioInDoublePrecision) {
  for (const std::string& name : names())
    for (size_t row = 0; row < rows_of(name); ++row) {
      const Dynamics<double> d = evaluate<double>(name, row);
      const auto check = [&](const std::vector<double>& x, const char* key, double tolerance) {
        EXPECT_LT(difference(x, sample<double>(reference(), name + key, row)), tolerance)
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
    for (size_t row = 0; row < rows_of(name); ++row) {
      const Dynamics<float> d = evaluate<float>(name, row);
      const auto check = [&](const std::vector<float>& x, const char* key, double tolerance) {
        EXPECT_LT(difference(x, sample<double>(reference(), name + key, row)), tolerance)
            << name << key << " " << row;
      };
      check(d.tau, "_tau", 1e-5);
      check(d.matrix, "_H", 1e-5);
      check(d.dtau_dq, "_dtau_dq", 1e-5);
      check(d.dtau_dqd, "_dtau_dqd", 1e-5);
      // Accelerations to what the condition of H allows.
      check(d.qdd, "_fd_qdd", name == "fr3" ? 2e-6 * 1.7e4 : 2e-4);
    }
}

}  // namespace
}  // namespace novaphy
