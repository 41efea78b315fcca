// Contact rows and solver sweeps in double precision, on handwritten trees.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/articulation/pgs.h"
#include "tree_reference.h"

namespace novaphy {
namespace {

using namespace articulation;

// A FREE root with two arms of hinges, turned and posed at random.
struct Scene {
  explicit Scene(uint32_t seed, bool by_links = false) : random(seed) {
    if (by_links) tree.joints_in_a_row = testing::TestTree<double>::kLong;
    const Mat33<double> inertia = {{{0.02, 0.001, 0}, {0.001, 0.03, 0.002}, {0, 0.002, 0.025}}};
    tree.add(LinkJoint::Free, -1, Transform<double>::identity(), Transform<double>::identity(),
             {0, 0, 1}, 2.0, {0.01, 0.02, -0.01}, inertia);
    for (const int parent : {0, 1, 0, 3})
      tree.add(LinkJoint::Revolute, parent, {vector(0.2), turn()}, {vector(0.2), turn()},
               unit(vector(1)), 0.7, vector(0.1), inertia);
    for (int k = 0; k < 3; ++k) q.push_back(number());
    const Quat<double> r = turn();
    for (const double x : {r.x, r.y, r.z, r.w}) q.push_back(x);
    for (int k = 0; k < 4; ++k) q.push_back(number());
    for (int k = 0; k < tree.dofs; ++k) qd.push_back(number());
    set(q);
    for (int k = 0; k < tree.dofs; ++k) ws.diagonal[k] = 0.01;
    EXPECT_EQ(factor(tree.view(), q.data(), ws), -1);
  }
  void set(const std::vector<double>& at) {
    ws = tree.workspace();
    kinematics(tree.view(), at.data(), ws);
  }
  double number() { return std::normal_distribution<double>()(random); }
  Vec3<double> vector(double s) { return {s * number(), s * number(), s * number()}; }
  static Vec3<double> unit(const Vec3<double>& v) { return v / std::sqrt(math::dot(v, v)); }
  Quat<double> turn() {
    const Quat<double> r = {number(), number(), number(), number()};
    return scaled(r, 1.0 / quat_length(r));
  }
  // Returns the world position of a point of a link.
  Vec3<double> world(int32_t link, const Vec3<double>& core) {
    return ws.links[link].origin + surface_point(ws.links[link], core, Vec3<double>{}).at;
  }

  std::mt19937 random;
  testing::TestTree<double> tree;
  Workspace<double> ws;
  std::vector<double> q, qd;
};

constexpr int32_t kWidth = 12;  // for 10 dofs
struct Rows {
  double jacobian[3 * kWidth] = {}, response[3 * kWidth] = {};
};

Rows rows_of(Scene& s, int32_t link, const Vec3<double>& core, const ContactFrame<double>& frame) {
  Rows r;
  const Tree<double> tree = s.tree.view();
  const Vec3<double> at = surface_point(s.ws.links[link], core, Vec3<double>{}).at;
  add_point_rows(tree, s.ws.axes, link, at, frame, 1.0, kWidth, r.jacobian);
  response_rows(tree, s.ws, last_dof(tree, link), kWidth, r.jacobian, r.response);
  return r;
}

TEST(ArticulationContacts, FramesAreRightHandedAndUnit) {
  Scene s(1);
  for (int i = 0; i < 50; ++i) {
    const Vec3<double> n = i < 3 ? unit_vector<double>(i) : Scene::unit(s.vector(1));
    const ContactFrame<double> f = contact_frame(n);
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        EXPECT_NEAR(math::dot(f.axes[a], f.axes[b]), a == b ? 1.0 : 0.0, 1e-14);
    const Vec3<double> n2 = math::cross(f.axes[1], f.axes[2]) - n;
    EXPECT_NEAR(math::dot(n2, n2), 0.0, 1e-28);
  }
}

// J qd is how fast the point of a link moves while the step moves q by qd.
TEST(ArticulationContacts, RowsAreVelocitiesOfPoints) {
  for (uint32_t seed = 0; seed < 5; ++seed) {
    Scene s(seed);
    const ContactFrame<double> frame = contact_frame(Scene::unit(s.vector(1)));
    for (int32_t link = 0; link < 5; ++link) {
      const Vec3<double> core = s.vector(0.2);
      s.set(s.q);
      Rows r;
      const Vec3<double> at = surface_point(s.ws.links[link], core, Vec3<double>{}).at;
      add_point_rows(s.tree.view(), s.ws.axes, link, at, frame, 1.0, kWidth, r.jacobian);
      const double h = 1e-6;
      Vec3<double> ends[2];
      for (int side = 0; side < 2; ++side) {
        std::vector<double> moved(s.q);
        integrate_coordinates(s.tree.view(), s.q.data(), s.qd.data(), side ? h : -h, moved.data());
        s.set(moved);
        ends[side] = s.world(link, core);
      }
      const Vec3<double> v = (ends[1] - ends[0]) / (2 * h);
      for (int row = 0; row < 3; ++row) {
        double jqd = 0;
        for (int k = 0; k < s.tree.dofs; ++k) jqd += r.jacobian[row * kWidth + k] * s.qd[k];
        EXPECT_NEAR(jqd, math::dot(frame.axes[row], v), 1e-8);
      }
    }
  }
}

TEST(ArticulationContacts, ResponsesAreThoseOfBothFactors) {
  Scene s(3), by_links(3, true);
  const ContactFrame<double> frame = contact_frame(Scene::unit(s.vector(1)));
  for (int32_t link = 0; link < 5; ++link) {
    const Rows r = rows_of(s, link, s.vector(0.2), frame);
    Rows any;
    response_rows(s.tree.view(), s.ws, -1, kWidth, r.jacobian, any.response);
    for (int row = 0; row < 3; ++row) {
      std::vector<double> x(r.jacobian + row * kWidth, r.jacobian + row * kWidth + s.tree.dofs);
      solve(by_links.tree.view(), by_links.ws, x.data());
      for (size_t k = 0; k < x.size(); ++k) {
        EXPECT_NEAR(r.response[row * kWidth + static_cast<int>(k)], x[k], 1e-12);
        EXPECT_NEAR(any.response[row * kWidth + static_cast<int>(k)], x[k], 1e-12);
      }
    }
  }
}

// Complementarity, the cone, and friction against the slip, of sweeps that have converged.
TEST(ArticulationContacts, SweepsSolveTheContactProblem) {
  int sticks = 0, slides = 0, breaks = 0;
  for (uint32_t seed = 10; seed < 90; ++seed) {
    Scene s(seed);
    double rates[kWidth] = {};
    for (int k = 0; k < s.tree.dofs; ++k) rates[k] = s.qd[k];
    const double mu = 0.3 + 0.05 * (seed % 8);
    std::vector<Rows> rows;
    for (const int32_t link : {2, 4, 0})
      rows.push_back(rows_of(s, link, s.vector(0.2), contact_frame(Scene::unit(s.vector(1)))));
    std::vector<PgsContact<double>> contacts(3);
    for (size_t i = 0; i < 3; ++i) {
      PgsContact<double>& c = contacts[i];
      c.sides[0] = {rates, rows[i].jacobian, rows[i].response, kWidth};
      c.friction = mu;
      c.cfm = i == 2 ? 0.2 : 0.0;
      c.bias = 0.1 * static_cast<double>(i);
      set_diagonals(c);
      set_steps(0.01, c);
    }
    double worst = 1;
    for (int sweeps = 0; sweeps < 20000 && worst > 1e-14; ++sweeps) {
      worst = 0;
      for (PgsContact<double>& c : contacts) worst = std::fmax(worst, sweep(c, true));
    }
    EXPECT_LT(worst, 1e-12);
    std::vector<double> expected(s.qd);  // v + M^-1 J^T lambda
    for (size_t i = 0; i < 3; ++i) {
      const PgsContact<double>& c = contacts[i];
      const double gap_rate = slip(c, 0) + c.bias + c.cfm * c.impulse[0];
      EXPECT_GE(c.impulse[0], 0.0);
      EXPECT_GT(gap_rate, -1e-10);
      EXPECT_NEAR(gap_rate * c.impulse[0], 0.0, 1e-10);
      const double x = slip(c, 1), y = slip(c, 2), slips = std::hypot(x, y);
      const double push = std::hypot(c.impulse[1], c.impulse[2]), limit = mu * c.impulse[0];
      EXPECT_LT(push, limit * (1 + 1e-12) + 1e-15);
      if (c.impulse[0] == 0.0) {
        ++breaks;
      } else if (push < limit * (1 - 1e-9)) {
        ++sticks;
        EXPECT_NEAR(slips, 0.0, 1e-9);
      } else {
        ++slides;  // all of the cone, against the slip
        EXPECT_NEAR(c.impulse[1] * x + c.impulse[2] * y, -push * slips, 1e-8 * (1 + push * slips));
      }
      for (size_t k = 0; k < expected.size(); ++k)
        for (int r = 0; r < 3; ++r)
          expected[k] += rows[i].response[r * kWidth + static_cast<int>(k)] * c.impulse[r];
    }
    for (size_t k = 0; k < expected.size(); ++k) EXPECT_NEAR(rates[k], expected[k], 1e-10);
  }
  EXPECT_GT(sticks, 3);
  EXPECT_GT(slides, 3);
  EXPECT_GT(breaks, 3);
}

TEST(ArticulationContacts, ThePyramidBoundsEachTangent) {
  Scene s(5);
  double rates[kWidth] = {};
  for (int k = 0; k < s.tree.dofs; ++k) rates[k] = s.qd[k];
  const Rows rows = rows_of(s, 2, s.vector(0.2), contact_frame(Scene::unit(s.vector(1))));
  PgsContact<double> c;
  c.sides[0] = {rates, rows.jacobian, rows.response, kWidth};
  c.friction = 0.1;
  set_diagonals(c);
  set_steps(0.01, c);
  c.bias = -slip(c, 0) - 1.0;  // pushed in
  for (int i = 0; i < 2000; ++i) sweep(c, false);
  EXPECT_GT(c.impulse[0], 0.0);
  for (int r = 1; r < 3; ++r) {
    EXPECT_LE(std::fabs(c.impulse[r]), 0.1 * c.impulse[0] * (1 + 1e-12));
    const bool inside = std::fabs(c.impulse[r]) < 0.0999 * c.impulse[0];
    EXPECT_NEAR(inside ? slip(c, r) : 0.0, 0.0, 1e-9);
  }
}

TEST(ArticulationContacts, NormalsFollowTheGap) {
  ContactLaw<double> law{0.01, 0.2, 0.001, 0.0, 1.0, 0.1, false, true};
  const ContactMaterial<double> m{0.5, 0.6, 1000.0, 20.0};
  const auto bias = [&](double gap, double before) {
    return normal_target(law, m, gap, before, before).bias;
  };
  EXPECT_DOUBLE_EQ(bias(0.02, 0.0), 2.0);       // may close
  EXPECT_DOUBLE_EQ(bias(-0.0005, 0.0), 0.0);    // within the slop
  EXPECT_DOUBLE_EQ(bias(-0.006, 0.0), 0.0);     // an overlap is no speed
  EXPECT_DOUBLE_EQ(bias(0.001, -2.0), -1.2);    // bounces
  EXPECT_DOUBLE_EQ(bias(0.03, -2.0), 3.0);      // does not reach the surface
  EXPECT_DOUBLE_EQ(bias(-0.0005, -0.05), 0.0);  // too slow to bounce
  const auto shift = [&](double gap, double before) {
    return normal_target(law, m, gap, before, before).shift;
  };
  EXPECT_DOUBLE_EQ(shift(0.02, 0.0), 2.0);
  EXPECT_DOUBLE_EQ(shift(-0.0005, 0.0), 0.0);
  EXPECT_DOUBLE_EQ(shift(-0.006, 0.0), -0.1);   // erp of what is beyond the slop
  EXPECT_DOUBLE_EQ(shift(-1.0, 0.0), -1.0);     // no faster than that
  EXPECT_DOUBLE_EQ(shift(-0.006, -2.0), -1.2);  // the bounce already opens the overlap
  law.slop = 0.0;
  law.erp = 1.0;
  EXPECT_NEAR(bias(-5e-5, 0.0), -5e-3, 1e-15);  // a contact at rest, but for rounding
  EXPECT_NEAR(bias(-0.005, 0.0), -0.01, 1e-9);  // its speed at most
  EXPECT_DOUBLE_EQ(shift(-0.005, 0.0), -0.5);
  law.compliant = true;
  const NormalTarget<double> soft = normal_target(law, m, -0.003, 0.0, 0.0);
  // lambda = dt (k (depth - dt v) - c v) at v' = 0.
  EXPECT_NEAR(-soft.bias / soft.cfm, 0.01 * 1000.0 * 0.003, 1e-12);
  EXPECT_DOUBLE_EQ(soft.shift, soft.bias);  // springs have no shifts
}

TEST(ArticulationContacts, NormalsThatJointsHardlyPartAreSoft) {
  PgsNumbers<double> c;
  c.apart = 2.0;
  c.tangent[0] = c.tangent[2] = 1.0;
  const double whole = c.apart + 1e-3 * (c.tangent[0] + c.tangent[2]);
  for (const double mobility : {1e-12, 1e-6, 1e-4}) {
    c.normal = mobility;
    c.cfm = 0.0;
    set_steps(0.01, c);
    EXPECT_NEAR(1.0 / c.normal_step, 1e-3 * (whole + 1e-3 * mobility), 1e-8);
  }
  c.normal = 0.01;  // a mobile normal stays hard
  c.cfm = 0.0;
  set_steps(0.01, c);
  EXPECT_EQ(c.cfm, 0.0);
}

TEST(ArticulationContacts, NormalsThatNothingMovesAreAsSoftAsTheMassSays) {
  PgsNumbers<double> c;
  c.mass = 4.0;
  for (const double mobility : {1e-12, 1e-4, 1e-3}) {
    c.normal = mobility;
    c.cfm = 0.0;
    set_steps(0.01, c);
    EXPECT_NEAR(1.0 / c.normal_step, 1e-2 / c.mass, 1e-9);
    EXPECT_NEAR(c.softness, 1e-2 / c.mass, 1e-6);
  }
  c.normal = 1.0 / c.mass;  // the mobility of a free body
  c.cfm = 0.0;
  set_steps(0.01, c);
  EXPECT_EQ(c.cfm, 0.0);
}

// A hinge of the inertia I with a contact at the lever l, which wants to move 0.01 m.
TEST(ArticulationContacts, ShiftsTurnNoJointFar) {
  constexpr double kInertia = 0.02, kWay = 0.01;
  for (const double lever : {1e-5, 1e-3, 0.01, 0.04, 0.2}) {
    PgsNumbers<double> c;
    c.normal = c.apart = lever * lever / kInertia;
    c.mass = 1e6;
    c.reach = lever / kInertia;
    c.shift = -kWay / 0.01;
    set_steps(0.01, c);
    const double angle = 0.01 * c.reach * -c.shift / (c.normal + c.softness);
    EXPECT_LT(angle, 0.1 * (1 + 1e-6));
    EXPECT_EQ(c.lack > 0.0, kWay / lever > 0.1 * 1.05) << lever;
  }
}

}  // namespace
}  // namespace novaphy
