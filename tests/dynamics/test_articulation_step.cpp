// The step of a tree and its adjoint, in double precision against central differences and the
// forward derivative, and against conservation laws.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <random>
#include <type_traits>

#include "novaphy/dynamics/articulation/dual.h"
#include "novaphy/dynamics/articulation/step_vjp.h"
#include "tree_reference.h"

namespace novaphy {
namespace {

using articulation::LinkJoint;
using testing::TestTree;

// Every array of a step, so that each can be moved and asked for its gradient.
template <class T>
struct Scene {
  TestTree<T> tree;
  std::vector<int32_t> mode;
  std::vector<T> q, qd, joint_f, target_q, target_qd, target_ke, target_kd, damping, armature,
      limit_lower, limit_upper, limit_ke, limit_kd, effort_limit, velocity_limit;
  std::vector<SpatialVector<T>> body_f;
  articulation::StepOptions<T> options{T(0.01), T(0.5), true};
  articulation::StepInputs<T> inputs() const {
    articulation::StepInputs<T> in = {};
    in.q = q.data();
    in.qd = qd.data();
    in.joint_f = joint_f.data();
    in.target_q = target_q.data();
    in.target_qd = target_qd.data();
    in.target_ke = target_ke.data();
    in.target_kd = target_kd.data();
    in.damping = damping.data();
    in.armature = armature.data();
    in.limit_lower = limit_lower.data();
    in.limit_upper = limit_upper.data();
    in.limit_ke = limit_ke.data();
    in.limit_kd = limit_kd.data();
    in.effort_limit = effort_limit.data();
    in.velocity_limit = velocity_limit.data();
    in.body_f = body_f.data();
    in.target_mode = mode.data();
    return in;
  }
};

template <class T>
struct Result {
  std::vector<T> q, qd, qdd;
  std::vector<Transform<T>> body_q;
  std::vector<SpatialVector<T>> body_qd;
  std::vector<int32_t> branch;
};

template <class T>
Result<T> step(Scene<T>& s) {
  const auto tree = s.tree.view();
  auto ws = s.tree.workspace();
  const auto in = s.inputs();
  Result<T> r;
  r.q = s.q;
  r.qd = s.qd;
  r.body_q.resize(s.tree.links.size());
  r.body_qd.resize(s.tree.links.size());
  EXPECT_EQ(articulation::forward_step(tree, in, s.options, ws), -1);
  r.qdd.assign(ws.qdd, ws.qdd + s.tree.dofs);
  r.branch.assign(ws.branch, ws.branch + s.tree.dofs);
  articulation::finish_step(tree, in, s.options, ws, r.q.data(), r.qd.data(), r.body_q.data(),
                            r.body_qd.data());
  return r;
}

class Random {
 public:
  explicit Random(uint32_t seed) : engine_(seed) {}
  double uniform(double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(engine_);
  }
  double normal() { return std::normal_distribution<double>()(engine_); }
  int index(int n) { return static_cast<int>(uniform(0, n - 1e-9)); }
  Vec3<double> vector(double s) { return {s * normal(), s * normal(), s * normal()}; }
  Quat<double> rotation() {
    const Quat<double> q = {normal(), normal(), normal(), normal()};
    return articulation::scaled(q, 1.0 / articulation::quat_length(q));
  }
  Mat33<double> inertia(double m) {
    const double a = uniform(0.02, 0.2), b = uniform(0.02, 0.2), c = uniform(0.02, 0.2);
    const SpatialInertia<double> y = math::rotate(
        rotation(),
        SpatialInertia<double>{
            m, {}, m * (b * b + c * c), m * (a * a + c * c), m * (a * a + b * b), 0, 0, 0});
    return {{{y.xx, y.xy, y.xz}, {y.xy, y.yy, y.yz}, {y.xz, y.yz, y.zz}}};
  }

 private:
  std::mt19937 engine_;
};

// Limits of BALL joints need a mass matrix.
void remove_ball_limits(Scene<double>& s) {
  for (const articulation::Link& link : s.tree.links)
    if (articulation::is_ball(link)) s.limit_upper[static_cast<size_t>(link.dof)] = 1e10;
}

Scene<double> random_scene(uint32_t seed, const std::vector<LinkJoint>& joints) {
  Random random(seed);
  Scene<double> s;
  s.tree.joints_in_a_row = seed % 4 > 1 ? TestTree<double>::kLong : TestTree<double>::kShort;
  for (size_t i = 0; i < joints.size(); ++i) {
    const Vec3<double> axis = random.vector(1);
    const double m = random.uniform(0.3, 2), length = std::sqrt(math::dot(axis, axis));
    const int parent = i == 0 ? -1 : std::max(0, static_cast<int>(i) - 1 - random.index(3));
    s.tree.add(joints[i], parent, {random.vector(0.3), random.rotation()},
               {random.vector(0.3), random.rotation()}, axis / length, m, random.vector(0.1),
               random.inertia(m));
    s.body_f.push_back({random.vector(3), random.vector(1)});
    if (joints[i] == LinkJoint::Free)
      for (int k = 0; k < 3; ++k) s.q.push_back(random.normal());
    if (joints[i] == LinkJoint::Free || joints[i] == LinkJoint::Ball) {
      const Quat<double> r = random.rotation();
      for (const double x : {r.x, r.y, r.z, r.w}) s.q.push_back(x);
    }
    if (articulation::has_one_dof(s.tree.links.back())) s.q.push_back(random.uniform(-1, 1));
  }
  s.target_q.resize(s.q.size());
  for (double& x : s.target_q) x = random.uniform(-1, 1);
  const auto fill = [&](std::vector<double>& x, double a, double b) {
    for (int i = 0; i < s.tree.dofs; ++i) x.push_back(random.uniform(a, b));
  };
  fill(s.qd, -2, 2);
  fill(s.joint_f, -2, 2);
  fill(s.target_qd, -1, 1);
  fill(s.target_ke, 0, 300);
  fill(s.target_kd, 0, 10);
  fill(s.damping, 0, 0.5);
  fill(s.armature, 0, 0.1);
  fill(s.limit_lower, -1.2, -0.3);
  fill(s.limit_upper, 0.3, 1.2);
  fill(s.limit_ke, 50, 100);
  fill(s.limit_kd, 0, 30);
  fill(s.effort_limit, 5, 60);
  fill(s.velocity_limit, 1, 4);
  for (int i = 0; i < s.tree.dofs; ++i) s.mode.push_back(1 + random.index(3));
  if (s.tree.joints_in_a_row == TestTree<double>::kLong) remove_ball_limits(s);
  return s;
}

std::vector<LinkJoint> all_joints(uint32_t seed) {
  Random random(seed + 1000);
  std::vector<LinkJoint> joints;
  for (int i = 0; i < 9; ++i) joints.push_back(static_cast<LinkJoint>(random.index(5)));
  if (seed % 2 == 0) joints[0] = LinkJoint::Free;
  return joints;
}

// The weights of a loss that is linear in all that a step gives.
struct Weights {
  std::vector<double> q, qd;
  std::vector<Transform<double>> body_q;
  std::vector<SpatialVector<double>> body_qd;
  Weights(const Scene<double>& s, uint32_t seed) : q(s.q), qd(s.qd) {
    Random random(seed);
    for (double& x : q) x = random.normal();
    for (double& x : qd) x = random.normal();
    for (size_t i = 0; i < s.tree.links.size(); ++i) {
      body_q.push_back({random.vector(1), random.rotation()});
      body_qd.push_back({random.vector(0.3), random.vector(0.3)});
    }
  }
  template <class T>
  T loss(const Result<T>& r) const {
    T sum = T(0.0);
    for (size_t i = 0; i < q.size(); ++i) sum = sum + r.q[i] * T(q[i]);
    for (size_t i = 0; i < qd.size(); ++i) sum = sum + r.qd[i] * T(qd[i]);
    for (size_t i = 0; i < body_q.size(); ++i) {
      const T *x = &r.body_q[i].p.x, *u = &r.body_qd[i].linear.x;
      const double *a = &body_q[i].p.x, *b = &body_qd[i].linear.x;
      for (size_t k = 0; k < 7; ++k) sum = sum + x[k] * T(a[k]);
      for (size_t k = 0; k < 6; ++k) sum = sum + u[k] * T(b[k]);
    }
    return sum;
  }
};

// An array of a scene as numbers, with its gradient.
struct Part {
  std::string name;
  double* values;
  std::vector<double> gradient;
};
std::vector<Part> parts(Scene<double>& s) {
  std::vector<Part> all;
  const auto add = [&](const char* name, double* x, size_t count) {
    all.push_back({name, x, std::vector<double>(count, 0.0)});
  };
  for (auto& [name, x] : std::initializer_list<std::pair<const char*, std::vector<double>*>>{
           {"q", &s.q}, {"qd", &s.qd}, {"joint_f", &s.joint_f}})
    add(name, x->data(), x->size());
  add("body_f", &s.body_f[0].linear.x, 6 * s.body_f.size());
  for (auto& [name, x] : std::initializer_list<std::pair<const char*, std::vector<double>*>>{
           {"target_q", &s.target_q},
           {"target_qd", &s.target_qd},
           {"target_ke", &s.target_ke},
           {"target_kd", &s.target_kd},
           {"damping", &s.damping},
           {"armature", &s.armature},
           {"limit_lower", &s.limit_lower},
           {"limit_upper", &s.limit_upper},
           {"limit_ke", &s.limit_ke},
           {"limit_kd", &s.limit_kd},
           {"effort_limit", &s.effort_limit},
           {"velocity_limit", &s.velocity_limit}})
    add(name, x->data(), x->size());
  add("mass", s.tree.mass.data(), s.tree.mass.size());
  add("com", &s.tree.com[0].x, 3 * s.tree.com.size());
  add("inertia", &s.tree.inertia[0].m[0][0], 9 * s.tree.inertia.size());
  return all;
}

void backward(Scene<double>& s, const Result<double>& r, const Weights& w, std::vector<Part>& all) {
  const auto tree = s.tree.view();
  auto ws = s.tree.workspace();
  const auto links = static_cast<int32_t>(s.tree.links.size());
  std::vector<unsigned char> memory(
      static_cast<size_t>(articulation::adjoint_bytes<double>(links, s.tree.dofs)));
  auto adjoint = articulation::make_adjoint_memory<double>(memory.data(), links, s.tree.dofs);
  articulation::StepGradient<double> g = {};
  // parts are in the order of the list; the last part, gravity, is not in the list
  size_t next = 0;
  articulation::for_each_gradient_array(
      [&](auto& to) {
        if (next < all.size())
          to = reinterpret_cast<std::remove_reference_t<decltype(to)>>(all[next++].gradient.data());
      },
      g);
  const std::vector<double> branch(r.branch.begin(), r.branch.end());
  articulation::step_vjp(tree, s.inputs(), s.options, r.qdd.data(), branch.data(), r.q.data(),
                         r.qd.data(), {w.q.data(), w.qd.data(), w.body_q.data(), w.body_qd.data()},
                         g, ws, adjoint);
}

// Words of kernels and bits of `add` rely on that.
TEST(ArticulationStep, ArraysStandInTheOrderOfTheirList) {
  articulation::StepArrays<articulation::Each<int32_t>> places = {};
  int32_t next = 0;
  articulation::for_each_array([&](int32_t& place) { place = next++; }, places);
  ASSERT_EQ(sizeof(places), sizeof(int32_t) * static_cast<size_t>(next));
  std::vector<int32_t> numbers(static_cast<size_t>(next));
  std::memcpy(numbers.data(), &places, sizeof(places));
  for (int32_t i = 0; i < next; ++i) EXPECT_EQ(numbers[static_cast<size_t>(i)], i);
}

// A change of one entry of a symmetric matrix sees the gradient of the symmetric part.
TEST(ArticulationStep, GradientsEqualCentralDifferencesForEveryInput) {
  int clamped = 0, outside = 0, released = 0, fast = 0, turned[2] = {0, 0};
  for (uint32_t seed = 0; seed < 30; ++seed) {
    const std::vector<LinkJoint> balls(6, LinkJoint::Ball);
    Scene<double> s = random_scene(seed, seed < 24 ? all_joints(seed) : balls);
    if (seed >= 24)  // makes some limits let go
      for (double& damping : s.limit_kd) damping *= 4;
    s.options.implicit_drives = seed % 3 != 0;
    const Weights weights(s, seed + 7);
    const Result<double> r = step(s);
    for (const int32_t b : r.branch) {
      clamped += (b & articulation::kEffortClamped) != 0;
      outside += (b & articulation::kOutside) != 0;
      released += (b & articulation::kLimitReleased) != 0;
      fast += (b & articulation::kVelocityClamped) != 0;
    }
    for (const articulation::Link& link : s.tree.links) {
      if (!articulation::is_ball(link)) continue;
      const int32_t b = r.branch[static_cast<size_t>(link.dof)];
      if ((b & articulation::kOutside) != 0) ++turned[(b & articulation::kLimitReleased) != 0];
    }
    std::vector<Part> all = parts(s);
    backward(s, r, weights, all);
    for (const Part& part : all)
      for (size_t i = 0; i < part.gradient.size(); ++i) {
        const double x = part.values[i], h = 1e-6 * std::fmax(1.0, std::abs(x));
        part.values[i] = x + h;
        const double up = weights.loss(step(s));
        part.values[i] = x - h;
        const double down = weights.loss(step(s));
        part.values[i] = x;
        const double expected = (up - down) / (2 * h);
        EXPECT_NEAR(part.gradient[i], expected, 1e-6 * (1 + std::abs(expected)))
            << part.name << "[" << i << "], seed " << seed;
      }
  }
  EXPECT_GT(clamped, 0);
  EXPECT_GT(outside, 0);
  EXPECT_GT(released, 0);
  EXPECT_GT(fast, 0);
  EXPECT_GT(turned[0], 0);
  EXPECT_GT(turned[1], 0);
}

// The scene in another scalar; `tangents` in the order of parts(), if there are any.
template <class T>
Scene<T> convert(const Scene<double>& s) {
  Scene<T> c;
  c.tree.links = s.tree.links;
  c.tree.dof_parent = s.tree.dof_parent;
  c.tree.coords = s.tree.coords;
  c.tree.dofs = s.tree.dofs;
  c.tree.joints_in_a_row = s.tree.joints_in_a_row;
  c.mode = s.mode;
  const auto copy = [](const auto& from, auto& to) {
    to.resize(from.size());
    const size_t n = sizeof(from[0]) / sizeof(double) * from.size();
    const double* x = reinterpret_cast<const double*>(from.data());
    T* y = reinterpret_cast<T*>(to.data());
    for (size_t i = 0; i < n; ++i) y[i] = T(x[i]);
  };
  copy(s.tree.X_p, c.tree.X_p);
  copy(s.tree.X_c, c.tree.X_c);
  copy(s.tree.axis, c.tree.axis);
  copy(s.tree.mass, c.tree.mass);
  copy(s.tree.com, c.tree.com);
  copy(s.tree.inertia, c.tree.inertia);
  c.tree.gravity = {T(s.tree.gravity.x), T(s.tree.gravity.y), T(s.tree.gravity.z)};
  copy(s.q, c.q);
  copy(s.qd, c.qd);
  copy(s.joint_f, c.joint_f);
  copy(s.body_f, c.body_f);
  copy(s.target_q, c.target_q);
  copy(s.target_qd, c.target_qd);
  copy(s.target_ke, c.target_ke);
  copy(s.target_kd, c.target_kd);
  copy(s.damping, c.damping);
  copy(s.armature, c.armature);
  copy(s.limit_lower, c.limit_lower);
  copy(s.limit_upper, c.limit_upper);
  copy(s.limit_ke, c.limit_ke);
  copy(s.limit_kd, c.limit_kd);
  copy(s.effort_limit, c.effort_limit);
  copy(s.velocity_limit, c.velocity_limit);
  c.options = {T(s.options.dt), T(s.options.angular_damping), s.options.implicit_drives};
  return c;
}

// <J x, y> = <x, J^T y>, J by dual numbers.
TEST(ArticulationStep, ForwardDerivativeIsTheTransposeOfTheGradient) {
  using D = articulation::Dual<double>;
  for (uint32_t seed = 0; seed < 12; ++seed) {
    Scene<double> s = random_scene(seed, all_joints(seed));
    const Weights weights(s, seed + 7);
    const Result<double> r = step(s);
    std::vector<Part> all = parts(s);
    backward(s, r, weights, all);
    Scene<D> dual = convert<D>(s);
    Random random(seed + 99);
    double expected = 0.0;
    for (const auto& [index, x] :
         std::initializer_list<std::pair<size_t, std::vector<D>*>>{{0, &dual.q},
                                                                   {1, &dual.qd},
                                                                   {2, &dual.joint_f},
                                                                   {4, &dual.target_q},
                                                                   {9, &dual.armature},
                                                                   {12, &dual.limit_ke},
                                                                   {16, &dual.tree.mass}})
      for (size_t i = 0; i < x->size(); ++i) {
        (*x)[i].tangent = random.normal();
        expected += (*x)[i].tangent * all[index].gradient[i];
      }
    EXPECT_NEAR(weights.loss(step(dual)).tangent, expected, 1e-10 * (1 + std::abs(expected)));
  }
}

// tau of ID(q, qd, qdd) with armature and the scene's wrenches, less joint_f.
std::vector<double> inverse_dynamics(Scene<double> s, const std::vector<float>& qdd) {
  const auto tree = s.tree.view();
  auto ws = s.tree.workspace();
  const std::vector<double> a(qdd.begin(), qdd.end());
  std::vector<double> tau(a.size());
  articulation::kinematics(tree, s.q.data(), ws);
  articulation::set_wrenches(tree, s.inputs(), ws);
  articulation::inverse_dynamics(tree, s.qd.data(), a.data(), ws, tau.data());
  for (size_t k = 0; k < tau.size(); ++k) tau[k] += s.armature[k] * a[k] - s.joint_f[k];
  return tau;
}
std::vector<LinkJoint> hinges_and_slides(uint32_t seed, LinkJoint root) {
  Random random(seed + 1000);
  std::vector<LinkJoint> joints = {root};
  for (int i = random.index(12); i >= 0; --i)
    joints.push_back(random.index(3) == 0 ? LinkJoint::Prismatic : LinkJoint::Revolute);
  return joints;
}

// Stiff drives with distant targets, most of which stop at a limit. Plain Newton steps would cycle
// in about a tenth of the scenes.
TEST(ArticulationStep, DrivesKeepToTheirEffortLimits) {
  int at_limit = 0;
  double worst = 0.0;
  for (uint32_t seed = 0; seed < 2000; ++seed) {
    Random random(seed);
    const LinkJoint root = seed % 2 ? LinkJoint::Free : LinkJoint::Revolute;
    Scene<double> s = random_scene(seed, hinges_and_slides(seed, root));
    const double gain = std::pow(10.0, random.uniform(1, 5)), far = random.uniform(0, 1);
    s.options = {std::pow(10.0, random.uniform(-3.3, -2)), 0.0, true};
    for (double& x : s.target_ke) x = gain * random.uniform(0.2, 1);
    for (size_t i = 0; i < s.q.size(); ++i) s.target_q[i] = s.q[i] + far * random.normal();
    for (auto* x : {&s.damping, &s.limit_ke, &s.limit_kd}) std::fill(x->begin(), x->end(), 0.0);
    std::fill(s.velocity_limit.begin(), s.velocity_limit.end(), 1e6);
    Scene<float> f = convert<float>(s);
    const Result<float> r = step(f);
    const std::vector<double> tau = inverse_dynamics(s, r.qdd);
    for (const articulation::Link& link : s.tree.links) {
      if (!articulation::has_one_dof(link)) continue;
      const auto k = static_cast<size_t>(link.dof);
      worst = std::fmax(worst, std::abs(tau[k]) / s.effort_limit[k]);
      at_limit += (r.branch[k] & articulation::kEffortClamped) != 0;
    }
  }
  EXPECT_LE(worst, 1.0 + 1e-3);
  EXPECT_GT(at_limit, 4000);
}

// The base of a free tree feels no force of its joints, and so none of their velocity limits.
TEST(ArticulationStep, VelocityLimitsKeepTheMomentumOfFreeTrees) {
  int at_limit = 0;
  for (uint32_t seed = 0; seed < 200; ++seed) {
    Random random(seed);
    Scene<double> s = random_scene(seed, hinges_and_slides(seed, LinkJoint::Free));
    s.tree.gravity = {};
    s.options.angular_damping = 0.0;
    for (SpatialVector<double>& f : s.body_f) f = {};
    for (double& x : s.armature) x = 0.0;
    for (size_t k = 0; k < 6; ++k) s.joint_f[k] = 0.0;
    for (double& x : s.velocity_limit) x = random.uniform(0.05, 2);
    Scene<float> f = convert<float>(s);
    const Result<float> r = step(f);
    const std::vector<double> tau = inverse_dynamics(s, r.qdd);
    const auto n = static_cast<size_t>(s.tree.dofs);
    auto ws = s.tree.workspace();
    articulation::kinematics(s.tree.view(), s.q.data(), ws);
    articulation::mass_matrix(s.tree.view(), ws);
    for (size_t k = 0; k < 6; ++k) {
      double size = 0.0;
      for (size_t j = 0; j < n; ++j)
        size += std::abs(ws.matrix[j > k ? j * n + k : k * n + j] * static_cast<double>(r.qd[j]));
      EXPECT_LT(std::abs(tau[k]) * s.options.dt, 1e-5 * size) << seed;
    }
    for (size_t k = 6; k < n; ++k) {
      EXPECT_LE(std::abs(r.qd[k]), f.velocity_limit[k]) << seed;
      at_limit += (r.branch[k] & articulation::kVelocityClamped) != 0;
    }
  }
  EXPECT_GT(at_limit, 300);
}

// The mass matrix and articulated bodies, with all joints, FREE ones below bodies too.
TEST(ArticulationStep, IsTheSameByBothFactors) {
  int held = 0;
  for (uint32_t seed = 0; seed < 24; ++seed) {
    Scene<double> s = random_scene(seed, all_joints(seed));
    remove_ball_limits(s);
    Scene<double> other = s;
    other.tree.joints_in_a_row = seed % 4 > 1 ? TestTree<double>::kShort : TestTree<double>::kLong;
    if (seed % 4 == 0) s.tree.links[0].joint = other.tree.links[0].joint = LinkJoint::Kinematic;
    const Result<double> a = step(s), b = step(other);
    EXPECT_EQ(a.branch, b.branch);
    for (size_t k = 0; k < a.qdd.size(); ++k)
      EXPECT_NEAR(a.qdd[k], b.qdd[k], 1e-9 * (1 + std::abs(a.qdd[k]))) << seed << " " << k;
    for (const int32_t branch : a.branch) held += (branch & articulation::kVelocityClamped) != 0;
  }
  EXPECT_GT(held, 10);
}

Scene<double> without_forces(Scene<double> s) {
  for (SpatialVector<double>& f : s.body_f) f = {};
  for (auto* x :
       {&s.joint_f, &s.target_ke, &s.target_kd, &s.damping, &s.armature, &s.limit_ke, &s.limit_kd})
    std::fill(x->begin(), x->end(), 0.0);
  std::fill(s.velocity_limit.begin(), s.velocity_limit.end(), 1e6);
  s.options.angular_damping = 0.0;
  return s;
}

TEST(ArticulationStep, MovesTheSameFarFromTheOriginToTheBit) {
  for (uint32_t seed = 0; seed < 6; ++seed) {
    const std::vector<LinkJoint> joints = {seed % 2 ? LinkJoint::Free : LinkJoint::Revolute,
                                           LinkJoint::Ball, LinkJoint::Prismatic,
                                           LinkJoint::Revolute, LinkJoint::Free};
    Scene<float> here = convert<float>(random_scene(seed, joints));
    here.options.dt = 2.5e-3f;
    Scene<float> there = here;
    there.tree.X_p[0].p = there.tree.X_p[0].p + Vec3f{1000.0f, 1000.0f, 0.0f};
    for (int t = 0; t < 100; ++t) {
      const Result<float> a = step(here), b = step(there);
      ASSERT_EQ(a.q, b.q);
      ASSERT_EQ(a.qd, b.qd);
      here.q = a.q;
      here.qd = a.qd;
      there.q = b.q;
      there.qd = b.qd;
    }
  }
}

// The drift of the energy over one second.
double energy_drift(Scene<double> s, double dt) {
  s.options.dt = dt;
  const auto energy = [&] {
    const auto tree = s.tree.view();
    auto ws = s.tree.workspace();
    articulation::kinematics(tree, s.q.data(), ws);
    articulation::link_motions(tree, s.qd.data(), ws);
    const auto e = articulation::energy(tree, ws);
    return e.kinetic + e.potential;
  };
  const double start = energy();
  double worst = 0.0;
  for (int t = 0; t < std::lround(1.0 / dt); ++t) {
    const Result<double> r = step(s);
    s.q = r.q;
    s.qd = r.qd;
    worst = std::fmax(worst, std::abs(energy() - start));
  }
  return worst;
}
TEST(ArticulationStep, DriftsInEnergyInProportionToTheStep) {
  for (uint32_t seed = 0; seed < 5; ++seed) {
    const Scene<double> s = without_forces(random_scene(
        seed, {LinkJoint::Free, LinkJoint::Ball, LinkJoint::Revolute, LinkJoint::Prismatic}));
    const double coarse = energy_drift(s, 1e-3), fine = energy_drift(s, 5e-4);
    EXPECT_GT(coarse, 0.0);
    EXPECT_NEAR(coarse / fine, 2.0, 0.1) << seed;
  }
}

double squared(const Vec3<double>& a) { return math::dot(a, a); }

// Returns the change of the momentum about the world's origin in a second of free flight.
SpatialVector<double> momentum_change(Scene<double> s, double dt) {
  s.tree.gravity = {};
  s.options.dt = dt;
  const auto momentum = [&] {
    const auto tree = s.tree.view();
    auto ws = s.tree.workspace();
    articulation::kinematics(tree, s.q.data(), ws);
    articulation::link_motions(tree, s.qd.data(), ws);
    SpatialVector<double> sum{};
    for (size_t i = 0; i < s.tree.links.size(); ++i) {
      const auto& l = ws.links[i];
      sum = sum + math::force_at(math::apply(l.inertia, l.v), -l.origin);
    }
    return sum;
  };
  const SpatialVector<double> start = momentum();
  for (int t = 0; t < std::lround(1.0 / dt); ++t) {
    const Result<double> r = step(s);
    s.q = r.q;
    s.qd = r.qd;
  }
  return momentum() - start;
}
TEST(ArticulationStep, KeepsMomentumInFreeFlightToTheOrderOfTheStep) {
  const Scene<double> s = without_forces(random_scene(
      3, {LinkJoint::Free, LinkJoint::Ball, LinkJoint::Revolute, LinkJoint::Prismatic}));
  const SpatialVector<double> coarse = momentum_change(s, 1e-4), fine = momentum_change(s, 5e-5);
  EXPECT_LT(squared(fine.linear), 1e-6);
  EXPECT_LT(squared(fine.angular), 1e-6);
  EXPECT_NEAR(squared(coarse.linear) / squared(fine.linear), 4.0, 0.2);
  EXPECT_NEAR(squared(coarse.angular) / squared(fine.angular), 4.0, 0.2);
}

// A target beyond the limit of a hinge: the drive and the limit come to rest against each other.
TEST(ArticulationStep, DrivesPressAgainstLimits) {
  for (const double ke : {10.0, 400.0, 1e4}) {
    Scene<double> s = without_forces(random_scene(1, {LinkJoint::Revolute}));
    s.tree.gravity = {};
    s.options.dt = 1e-3;
    s.mode = {1};
    s.target_ke = {ke};
    s.target_kd = {1.0};
    s.target_q = {1.5};
    s.limit_upper = {1.0};
    s.limit_ke = {1e4};
    s.limit_kd = {10.0};
    s.effort_limit = {1e9};
    s.q = {0.0};
    s.qd = {0.0};
    for (int t = 0; t < 4000; ++t) {
      const Result<double> r = step(s);
      s.q = r.q;
      s.qd = r.qd;
    }
    EXPECT_NEAR(s.q[0], (1.5 * ke + 1e4) / (ke + 1e4), 1e-6) << ke;
    EXPECT_NEAR(s.qd[0], 0.0, 1e-6) << ke;
  }
}

// Backward Euler of one hinge: v' = (I v + dt (ke (q* - q))) / (I + dt kd + dt^2 ke), with gains
// that an explicit drive cannot have.
TEST(ArticulationStep, DrivesAreStableWhateverTheirGains) {
  Scene<double> s = without_forces(random_scene(1, {LinkJoint::Revolute}));
  s.tree.gravity = {};
  s.mode = {3};
  s.target_ke = {1e5};
  s.target_kd = {1e3};
  s.effort_limit = {1e9};
  s.target_q = {0.5};
  s.target_qd = {0.0};
  s.q = {0.0};
  s.qd = {1.0};
  auto ws = s.tree.workspace();
  articulation::kinematics(s.tree.view(), s.q.data(), ws);
  articulation::mass_matrix(s.tree.view(), ws);
  const double inertia = ws.matrix[0], dt = s.options.dt;
  double q = 0.0, v = 1.0;
  for (int t = 0; t < 300; ++t) {
    const Result<double> r = step(s);
    s.q = r.q;
    s.qd = r.qd;
    v = (inertia * v + dt * 1e5 * (0.5 - q)) / (inertia + dt * 1e3 + dt * dt * 1e5);
    q += dt * v;
    EXPECT_NEAR(s.q[0], q, 1e-12);
    EXPECT_NEAR(s.qd[0], v, 1e-10);
  }
  EXPECT_NEAR(q, 0.5, 1e-9);
}

}  // namespace
}  // namespace novaphy
