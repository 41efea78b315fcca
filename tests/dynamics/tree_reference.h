// Trees with their own arrays for tests, read from the file of reference trees or built by hand.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "novaphy/dynamics/articulation/derivatives.h"
#include "novaphy/dynamics/articulation/inverse_dynamics_vjp.h"
#include "support/npz.h"

namespace novaphy::testing {

template <class T>
struct TestTree {
  // Numbers of joints in a row that choose the factor of the mass matrix, or that of articulated
  // bodies.
  static constexpr int32_t kShort = 0, kLong = articulation::kMatrixJoints + 1;

  std::vector<articulation::Link> links;
  std::vector<int32_t> dof_parent;
  std::vector<Transform<T>> X_p, X_c;
  std::vector<Vec3<T>> axis;
  std::vector<T> mass;
  std::vector<Vec3<T>> com;
  std::vector<Mat33<T>> inertia;
  std::vector<T> armature;
  Vec3<T> gravity = {T(0), T(0), T(-9.81)};
  int32_t coords = 0, dofs = 0;
  int32_t joints_in_a_row = 0;  // reported number, which chooses the factor

  std::vector<unsigned char> memory;
  std::vector<articulation::DofMotion<T>> motions;
  std::vector<articulation::MotionBias<T>> biases;

  void add(articulation::LinkJoint type, int32_t parent, const Transform<T>& x_p,
           const Transform<T>& x_c, const Vec3<T>& a, T m, const Vec3<T>& c, const Mat33<T>& i) {
    const auto row = static_cast<int32_t>(links.size());
    const bool one =
        type == articulation::LinkJoint::Revolute || type == articulation::LinkJoint::Prismatic;
    const int32_t n = one                                     ? 1
                      : type == articulation::LinkJoint::Ball ? 3
                      : type == articulation::LinkJoint::Free ? 6
                                                              : 0;
    links.push_back({type, parent, row, row, row, coords, dofs, n});
    X_p.push_back(x_p);
    X_c.push_back(x_c);
    mass.push_back(m);
    com.push_back(c);
    inertia.push_back(i);
    int32_t above = -1;
    for (int32_t p = parent; p >= 0 && above < 0; p = links[static_cast<size_t>(p)].parent) {
      const articulation::Link& l = links[static_cast<size_t>(p)];
      if (l.dofs > 0) above = l.dof + l.dofs - 1;
    }
    for (int32_t k = 0; k < n; ++k) {
      dof_parent.push_back(k == 0 ? above : dofs + k - 1);
      axis.push_back(a);
    }
    coords += n == 3 ? 4 : n == 6 ? 7 : n;
    dofs += n;
  }
  articulation::Tree<T> view() const {
    return {static_cast<int32_t>(links.size()),
            dofs,
            links.data(),
            dof_parent.data(),
            0,
            X_p.data(),
            X_c.data(),
            axis.data(),
            mass.data(),
            com.data(),
            inertia.data(),
            gravity,
            0,
            joints_in_a_row};
  }
  articulation::Workspace<T> workspace() {
    const auto count = static_cast<int32_t>(links.size());
    const int32_t rows = std::max(dofs, joints_in_a_row);
    memory.assign(static_cast<size_t>(articulation::workspace_bytes<T>(count, rows)), 0);
    motions.resize(static_cast<size_t>(dofs));
    biases.resize(links.size());
    return articulation::make_workspace<T>(memory.data(), count, rows);
  }
};

template <class T>
Vec3<T> to_vec3(const double* x) {
  return {T(x[0]), T(x[1]), T(x[2])};
}
template <class T>
Transform<T> to_transform(const double* x) {
  return {to_vec3<T>(x), {T(x[3]), T(x[4]), T(x[5]), T(x[6])}};
}

// tests/golden/pinocchio_trees.npz: random trees evaluated by Pinocchio 4.1 in double precision.
template <class T>
TestTree<T> load_tree(const Npz& file, const std::string& name) {
  TestTree<T> tree;
  const auto type = file[name + "_type"].as<int32_t>(),
             parent = file[name + "_parent"].as<int32_t>();
  const auto numbers = [&](const char* key) { return file[name + key].as<double>().data(); };
  const double *axis = numbers("_axis"), *x_p = numbers("_X_p"), *x_c = numbers("_X_c"),
               *mass = numbers("_mass"), *com = numbers("_com"), *inertia = numbers("_inertia");
  for (size_t i = 0; i < type.size(); ++i) {
    Mat33<T> about_com;
    for (size_t k = 0; k < 9; ++k) about_com.m[k / 3][k % 3] = T(inertia[9 * i + k]);
    tree.add(static_cast<articulation::LinkJoint>(type[i]), parent[i], to_transform<T>(x_p + 7 * i),
             to_transform<T>(x_c + 7 * i), to_vec3<T>(axis + 3 * i), T(mass[i]),
             to_vec3<T>(com + 3 * i), about_com);
  }
  for (const double a : file[name + "_armature"].as<double>()) tree.armature.push_back(T(a));
  tree.gravity = to_vec3<T>(numbers("_gravity"));
  return tree;
}

// Row `sample` of an array of the file.
template <class T>
std::vector<T> sample(const Npz& file, const std::string& key, size_t row) {
  const NpyArray& array = file[key];
  const size_t width = array.size() / array.shape[0];
  const double* x = array.as<double>().data() + row * width;
  std::vector<T> values;
  for (size_t i = 0; i < width; ++i) values.push_back(T(x[i]));
  return values;
}

}  // namespace novaphy::testing
