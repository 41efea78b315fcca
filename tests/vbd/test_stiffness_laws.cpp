// The stiffness of elements over all of their corners (stiffness_law.h), in double precision.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "novaphy/vbd/elements/list.h"
#include "real64.h"
#include "slots.h"

namespace novaphy::vbd {
namespace {

using testing::Real64;
using Point = Vec3<Real64>;
using Matrix = std::vector<std::vector<double>>;

std::mt19937 random_engine(11);
Real64 random(double low, double high) {
  return Real64(std::uniform_real_distribution<double>(low, high)(random_engine));
}
Point random_point(double size) {
  return {random(-size, size), random(-size, size), random(-size, size)};
}
double component(const Point& p, size_t k) { return k == 0 ? p.x.v : k == 1 ? p.y.v : p.z.v; }

// An element with its parameters, where its corners are and where the step began.
template <Role first>
struct Element {
  using Slot = SlotOf<first>;
  static constexpr size_t kCorners = Slot::kCorners;
  std::array<Point, kCorners> x, start;
  std::initializer_list<Real64> parameters;

  // Calls body(inputs, corner) with the slot of each corner.
  template <class Body>
  void for_corners(const Body& body) const {
    for (int c = 0; c < static_cast<int>(kCorners); ++c)
      for_roles([&](auto is) {
        constexpr Role role = decltype(is)::role;
        if constexpr (role == first ||
                      (Slot::kCorners == 4 && first == kHingeOpposite && role == kHingeEnd)) {
          if (role - first == (first == kHingeOpposite ? c / 2 : 0))
            body(testing::slot_of<role, Real64>(c, x, start, parameters, Real64(0.01)), c);
        }
      });
  }
  std::vector<double> force() const {
    std::vector<double> all;
    for_corners([&](const auto& in, int) {
      const Point f = block_of(in, true).f;
      for (size_t k = 0; k < 3; ++k) all.push_back(component(f, k));
    });
    return all;
  }
  Matrix stiffness() const {
    Matrix h(3 * kCorners, std::vector<double>(3 * kCorners, 0.0));
    for_corners([&](const auto& in, int corner) {
      stiffness_of(in, true, [&](int k, const Mat33<Real64>& of) {
        const int other = k == 0 ? corner : Slot::other_corner(corner, k - 1);
        for (int r = 0; r < 3; ++r)
          for (int c = 0; c < 3; ++c)
            h[static_cast<size_t>(3 * corner + r)][static_cast<size_t>(3 * other + c)] =
                of.m[r][c].v;
      });
    });
    return h;
  }
  // Minus the derivative of the forces, by central differences.
  Matrix differences() const {
    Matrix h = stiffness();
    constexpr double kStep = 1e-6;
    for (size_t column = 0; column < h.size(); ++column) {
      const auto at = [&](double step) {
        Element moved = *this;
        Point& p = moved.x[column / 3];
        Real64& number = column % 3 == 0 ? p.x : column % 3 == 1 ? p.y : p.z;
        number = number + Real64(step);
        return moved.force();
      };
      const std::vector<double> behind = at(-kStep), before = at(kStep);
      for (size_t row = 0; row < h.size(); ++row)
        h[row][column] = (behind[row] - before[row]) / (2.0 * kStep);
    }
    return h;
  }
};

double size_of(const Matrix& h) {
  double size = 1e-12;
  for (const auto& row : h)
    for (const double entry : row) size = std::max(size, std::abs(entry));
  return size;
}
// Symmetric, without force where all corners move alike, and without a negative eigenvalue.
void expect_stiffness(Matrix h) {
  const double size = size_of(h);
  for (size_t r = 0; r < h.size(); ++r) {
    double sum[3] = {};
    for (size_t c = 0; c < h.size(); ++c) {
      EXPECT_NEAR(h[r][c], h[c][r], 1e-9 * size);
      sum[c % 3] += h[r][c];
    }
    for (const double of_all : sum) EXPECT_NEAR(of_all, 0.0, 1e-9 * size);
  }
  for (size_t k = 0; k < h.size(); ++k) h[k][k] += 1e-7 * size;
  for (size_t k = 0; k < h.size(); ++k) {
    ASSERT_GT(h[k][k], 0.0) << k;
    for (size_t r = k + 1; r < h.size(); ++r)
      for (size_t c = k + 1; c < h.size(); ++c) h[r][c] -= h[r][k] * h[k][c] / h[k][k];
  }
}
void expect_equal(const Matrix& h, const Matrix& expected) {
  for (size_t r = 0; r < h.size(); ++r)
    for (size_t c = 0; c < h.size(); ++c)
      EXPECT_NEAR(h[r][c], expected[r][c], 1e-5 * size_of(expected)) << r << ", " << c;
}

// Turned by a half turn about a random axis, stretched before along the axes.
template <size_t n>
std::array<Point, n> stretched(const std::array<Point, n>& rest, double x, double y, double z) {
  const Point axis = math::normalize(random_point(1.0));
  std::array<Point, n> moved;
  for (size_t k = 0; k < n; ++k) {
    const Point p = {rest[k].x * Real64(x), rest[k].y * Real64(y), rest[k].z * Real64(z)};
    moved[k] = axis * (Real64(2.0) * math::dot(axis, p)) - p;
  }
  return moved;
}
template <size_t n>
std::array<Point, n> scattered(double size) {
  std::array<Point, n> all;
  for (Point& p : all) p = random_point(size);
  return all;
}

const Real64 zero(0.0), one(1.0);
const std::array<Point, 3> kTriangleAtRest = {
    {{zero, zero, zero}, {one, zero, zero}, {zero, one, zero}}};
const std::array<Point, 4> kTetAtRest = {
    {{zero, zero, zero}, {one, zero, zero}, {zero, one, zero}, {zero, zero, one}}};

TEST(VbdStiffness, AStretchedTriangleHasItsSecondDerivative) {
  for (const auto& [x, y] : {std::pair(1.0, 1.0), std::pair(1.05, 1.05), std::pair(1.2, 1.1),
                             std::pair(1.0, 1.3), std::pair(1.3, 1.2)}) {
    const auto at = stretched(kTriangleAtRest, x, y, 1.0);
    const Element<kTriangle> e = {
        at, at, {one, zero, zero, one, Real64(0.5), Real64(20.0), Real64(30.0), zero, zero}};
    expect_equal(e.stiffness(), e.differences());
    expect_stiffness(e.stiffness());
  }
}
TEST(VbdStiffness, ATurnedTriangleAtRestResistsNoTurn) {
  const auto at = stretched(kTriangleAtRest, 1.0, 1.0, 1.0);
  const Element<kTriangle> e = {
      at, at, {one, zero, zero, one, Real64(0.5), Real64(20.0), Real64(30.0), zero, zero}};
  const Matrix h = e.stiffness();
  const Point spin = random_point(1.0);
  double energy = 0.0;
  std::vector<double> turn;
  for (const Point& p : at)
    for (size_t k = 0; k < 3; ++k) turn.push_back(component(math::cross(spin, p), k));
  for (size_t r = 0; r < 9; ++r)
    for (size_t c = 0; c < 9; ++c) energy += turn[r] * h[r][c] * turn[c];
  EXPECT_NEAR(energy, 0.0, 1e-9 * size_of(h));
}
TEST(VbdStiffness, ATetrahedronNearRestHasItsSecondDerivative) {
  for (const double stretch : {1.0, 1.02, 1.1}) {
    const auto at = stretched(kTetAtRest, stretch, stretch, stretch);
    const Element<kTetrahedron> e = {at,
                                     at,
                                     {one, zero, zero, zero, one, zero, zero, zero, one,
                                      Real64(20.0), Real64(30.0), zero, zero}};
    expect_equal(e.stiffness(), e.differences());
  }
}
TEST(VbdStiffness, ABendingEdgeAtItsAngleHasItsSecondDerivative) {
  for (int trial = 0; trial < 20; ++trial) {
    const std::array<Point, 4> at = {{{zero, one, random(-0.5, 0.5)},
                                      {zero, -one, random(-0.5, 0.5)},
                                      {-one, zero, zero},
                                      {one, zero, zero}}};
    const Real64 angle = math::make_hinge(at[0], at[1], at[2], at[3]).angle;
    const Element<kHingeOpposite> e = {at, at, {Real64(3.0), Real64(0.01), angle, Real64(2.0)}};
    expect_equal(e.stiffness(), e.differences());
    expect_stiffness(e.stiffness());
  }
}
// The elements include inverted, flat and compressed ones, with damping and activation.
TEST(VbdStiffness, NoElementHasANegativeEigenvalue) {
  for (int trial = 0; trial < 300; ++trial) {
    const Real64 kd = trial % 2 == 0 ? zero : random(0.0, 0.1);
    expect_stiffness(
        Element<kSpring>{scattered<2>(1.0), scattered<2>(1.0), {random(0, 9), kd, random(0.1, 2)}}
            .stiffness());
    expect_stiffness(Element<kTriangle>{
        scattered<3>(1.0),
        scattered<3>(1.0),
        {random(0.5, 2), random(-1, 1), zero, random(0.5, 2), random(0.1, 1), random(0, 9),
         random(0, 99), kd,
         random(-0.5,
                0.5)}}.stiffness());
    expect_stiffness(Element<kTetrahedron>{
        scattered<4>(1.0),
        scattered<4>(1.0),
        {random(0.5, 2), random(-1, 1), zero, zero, random(0.5, 2), random(-1, 1), zero, zero,
         random(0.5, 2), random(0, 9), random(0, 99), kd,
         random(-0.5,
                0.5)}}.stiffness());
    expect_stiffness(Element<kHingeOpposite>{
        scattered<4>(1.0), scattered<4>(1.0), {random(0, 9), kd, random(-1, 1), random(0.1, 1)}}
                         .stiffness());
  }
}

}  // namespace
}  // namespace novaphy::vbd
