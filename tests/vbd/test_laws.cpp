// The laws of VBD in double precision: forces are minus the derivatives of the stated energies, and
// the Hessians have the properties that the headers state.
#include <gtest/gtest.h>

#include <random>

#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "real64.h"
#include "slots.h"

namespace novaphy::vbd {
namespace {

using testing::energy_at;
using testing::force_at;
using testing::Real64;
using Point = Vec3<Real64>;

std::mt19937 random_engine(7);
Real64 random(double low, double high) {
  return Real64(std::uniform_real_distribution<double>(low, high)(random_engine));
}
Point random_point(double size = 1.0) {
  return {random(-size, size), random(-size, size), random(-size, size)};
}
Point near(const Point& x, double distance) { return x + random_point(distance); }

// The gradient of a function of the position, by central differences.
template <class Energy>
Point gradient(const Energy& energy, const Point& x) {
  const Real64 h(1e-6);
  const auto along = [&](const Point& d) { return (energy(x + d) - energy(x - d)) / (h + h); };
  const Real64 zero;
  return {along({h, zero, zero}), along({zero, h, zero}), along({zero, zero, h})};
}

void expect_force(const Block<Real64>& block, const Point& energy_gradient) {
  const double size = std::max(1.0, math::length(energy_gradient).v);
  EXPECT_LT(math::length(block.f + energy_gradient).v, 2e-7 * size);
}

// H has no eigenvalue below -tolerance: H + tolerance has positive pivots.
void expect_semidefinite(Block<Real64> block) {
  const double size = std::max({block.h00.v, block.h11.v, block.h22.v, 1e-12});
  add_identity(block, Real64(1e-9 * size));
  const auto factors = factorize(block, Real64(0.0));
  for (const Real64& d : factors.d) EXPECT_GT(d.v, 0.0);
}

// H d is how the force falls along d.
template <class Force>
void expect_exact(const Block<Real64>& block, const Force& force, const Point& x) {
  const Point d = random_point();
  const Real64 h(1e-6);
  const Point change = (force(x - d * h) - force(x + d * h)) / (h + h);
  const Point hd = multiply_stiffness(block, d);
  EXPECT_LT(math::length(change - hd).v, 1e-6 * std::max(1.0, math::length(hd).v));
}

// The force of a slot is minus the derivative of its energy, and H has no negative eigenvalue.
template <Role role>
void expect_law(const SlotInputs<role, Real64>& in) {
  const auto block = block_of(in, true);
  expect_force(block, gradient([&](const Point& p) { return energy_at(in, p); }, in.own));
  expect_semidefinite(block);
}

TEST(VbdLaws, ASpringsForceIsMinusTheDerivativeOfItsEnergy) {
  for (int trial = 0; trial < 100; ++trial) {
    const Point x = random_point(), other = random_point();
    SlotInputs<kSpring, Real64> in = {
        x, {other}, {random(0, 100), random(0, 10), random(0.1, 2), random(0.1, 2)}};
    expect_law(in);
    const Point force = force_at(in, x);
    SlotInputs<kSpring, Real64> back = in;
    back.others[0] = x;
    EXPECT_LT(math::length(force + force_at(back, other)).v, 1e-9);
    // Without the projection H lacks only the second derivative from the damper's rotation.
    in.numbers[1] = Real64(0.0);
    const auto elastic = [&in](const Point& p) { return force_at(in, p); };
    expect_exact(Spring::block<Block, false>(in, true), elastic, x);
    if (Spring::length(in) > in.numbers[2]) expect_exact(block_of(in, true), elastic, x);
  }
}

// Force and Hessian of a rope are the derivatives of its energy, on both sides of the kink.
TEST(VbdLaws, ARopePullsAndNeverPushes) {
  int taut = 0, slack = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const SlotInputs<kRope, Real64> in = {
        random_point(),
        {random_point()},
        {random(0, 100), trial % 2 == 0 ? Real64(0.0) : random(0, 50), random(0.1, 2),
         random(0.1, 2)}};
    const Real64 pull = Rope::pull(in, Rope::length(in));
    if (std::abs(pull.v) < 1e-3) continue;  // the kink
    expect_law(in);
    const auto block = block_of(in, true);
    expect_exact(
        block, [&in](const Point& p) { return force_at(in, p); }, in.own);
    const Real64 along = math::dot(block.f, in.own - in.others[0]);
    if (Rope::length(in).v <= in.numbers[2].v) {
      EXPECT_LE(pull.v, 0.0);
    }
    if (pull.v > 0.0) {
      ++taut;
      EXPECT_LT(along.v, 0.0);
    } else {
      ++slack;
      EXPECT_EQ(along.v, 0.0);
      EXPECT_EQ(block.h00.v + block.h11.v + block.h22.v, 0.0);
    }
  }
  EXPECT_GT(taut, 50);
  EXPECT_GT(slack, 50);
}

// A spring that is pressed to half its length has an indefinite second derivative; H does not.
TEST(VbdLaws, APressedSpringIsProjected) {
  const SlotInputs<kSpring, Real64> in = {{Real64(0.5), Real64(0.0), Real64(0.0)},
                                          {Point{}},
                                          {Real64(10.0), Real64(0.0), Real64(1.0), Real64(1.0)}};
  const auto exact = Spring::block<Block, false>(in, true), used = Spring::block(in, true);
  EXPECT_DOUBLE_EQ(exact.h11.v, -10.0);
  EXPECT_DOUBLE_EQ(used.h11.v, 0.0);
  EXPECT_DOUBLE_EQ(used.h00.v, exact.h00.v);
}

TEST(VbdLaws, AMembranesForceIsMinusTheDerivativeOfItsEnergy) {
  int extended = 0;
  for (int trial = 0; trial < 200; ++trial) {
    SlotInputs<kTriangle, Real64> in = {random_point(), {random_point(), random_point()}, {}};
    for (int k = 0; k < Triangle::kWeights; ++k) in.numbers[k] = random(-2, 2);
    const Real64 kd = trial % 2 == 0 ? Real64(0.0) : random(0, 5);
    put_neo_hookean(Triangle::kWeights, random(0.1, 1), random(0, 100), random(0, 100),
                    random(-0.5, 0.5), kd,
                    [&in](int k, const Real64& value) { in.numbers[k] = value; });
    const Point before[] = {near(in.others[0], 0.1), near(in.others[1], 0.1)};
    testing::set_start<kTriangle, Real64>(in, near(in.own, 0.1), before);
    expect_law(in);
    if (kd.v != 0.0) continue;
    const auto c = Triangle::columns(in);
    if (Triangle::area_ratio(math::cross(c.f0, c.f1)) < in.numbers[6]) continue;
    ++extended;
    expect_exact(
        block_of(in, false), [&](const Point& p) { return force_at(in, p); }, in.own);
  }
  EXPECT_GT(extended, 20);
}

TEST(VbdLaws, ATetrahedronsForceAndHessianAreTheDerivativesOfItsEnergy) {
  int inverted = 0;
  for (int trial = 0; trial < 200; ++trial) {
    SlotInputs<kTetrahedron, Real64> in = {
        random_point(), {random_point(), random_point(), random_point()}, {}};
    for (int k = 0; k < Tetrahedron::kWeights; ++k) in.numbers[k] = random(-2, 2);
    const Real64 kd = trial % 2 == 0 ? Real64(0.0) : random(0, 5);
    put_neo_hookean(Tetrahedron::kWeights, random(0.1, 1), random(0.1, 100), random(0, 100),
                    random(-0.5, 0.5), kd,
                    [&in](int k, const Real64& value) { in.numbers[k] = value; });
    const Point before[] = {near(in.others[0], 0.1), near(in.others[1], 0.1),
                            near(in.others[2], 0.1)};
    testing::set_start<kTetrahedron, Real64>(in, near(in.own, 0.1), before);
    expect_law(in);
    const auto g = Tetrahedron::columns(in);
    inverted += math::dot(g.f[0], math::cross(g.f[1], g.f[2])).v < 0.0;
    if (kd.v != 0.0) continue;
    expect_exact(
        block_of(in, false), [&](const Point& p) { return force_at(in, p); }, in.own);
  }
  EXPECT_GT(inverted, 50);
}

TEST(VbdLaws, ABendingEdgesForceIsMinusTheDerivativeOfItsEnergy) {
  for (int trial = 0; trial < 100; ++trial) {
    const Real64 zero, one(1.0);
    const Point x[] = {near({zero, one, zero}, 0.4), near({zero, -one, zero}, 0.4),
                       near({-one, zero, zero}, 0.4), near({one, zero, zero}, 0.4)};
    const Real64 numbers[] = {random(0, 10), random(0, 2), random(-1, 1), random(-0.5, 0.5)};
    Point sum;
    const auto add = [&](auto is, int corner) {
      constexpr Role role = decltype(is)::role;
      SlotInputs<role, Real64> in = {x[corner], {}, {}};
      for (int k = 0; k < 3; ++k) in.others[k] = x[Hinge::other_corner(corner, k)];
      for (int k = 0; k < 4; ++k) in.numbers[k] = numbers[k];
      expect_law(in);
      sum = sum + block_of(in, true).f;
    };
    for (int corner = 0; corner < 4; ++corner) {
      if (corner < 2) {
        add(RoleIs<kHingeOpposite>(), corner);
      } else {
        add(RoleIs<kHingeEnd>(), corner);
      }
    }
    EXPECT_LT(math::length(sum).v, 1e-9);
  }
}

TEST(VbdLaws, AContactsForceIsMinusTheDerivativeOfItsEnergyUnderItsLoad) {
  int fast = 0, slow = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Point n = math::normalize(random_point());
    const Point x = random_point(), start = near(x, trial % 2 == 0 ? 1e-3 : 1e-2);
    const ParticleContact<Real64> contact = {x - n * random(0.01, 0.1),
                                             n,
                                             random_point(1e-3),
                                             random(0.1, 0.2),
                                             random(1, 1000),
                                             random(0, 10),
                                             random(0, 1),
                                             Real64(2e-3)};
    const Real64 load = particle_contact_load(x, contact);
    const auto block = particle_contact_block(x, start, contact);
    const Real64 h(1e-8);
    const auto energy = [&](const Point& p) {
      return particle_contact_energy(p, start, contact, load);
    };
    const auto along = [&](const Point& d) { return (energy(x + d) - energy(x - d)) / (h + h); };
    const Real64 zero;
    const Point slope = {along({h, zero, zero}), along({zero, h, zero}), along({zero, zero, h})};
    EXPECT_LT(math::length(block.f + slope).v, 1e-5 * std::max(1.0, math::length(slope).v));
    expect_semidefinite(block);
    const Point u = (x - start) - contact.travel;
    (math::length(u - n * math::dot(n, u)) > contact.slip ? fast : slow) += 1;
  }
  EXPECT_GT(fast, 20);
  EXPECT_GT(slow, 20);
}

TEST(VbdLaws, ASeparatedContactAndAFlatHingeHaveNoBlock) {
  const Vec3f up = {0.0f, 0.0f, 1.0f};
  const ParticleContact<float> contact = {{}, up, {}, 0.1f, 1e4f, 10.0f, 0.5f, 1e-4f};
  const auto far = particle_contact_block({0.0f, 0.0f, 0.11f}, {1.0f, 0.0f, 0.5f}, contact);
  EXPECT_EQ(math::length(far.f) + far.h00 + far.h22, 0.0f);
  const Vec3f a = {0.0f, 1.0f, 0.0f}, b = {-1.0f, 0.0f, 0.0f};
  const SlotInputs<kHingeEnd, float> in = {b, {a, a, b}, {1.0f, 1.0f, 0.0f, 0.0f}};
  const auto degenerate = block_of(in, true);
  EXPECT_EQ(math::length(degenerate.f) + degenerate.h00, 0.0f);
}

// A block that is singular up to rounding is regularized, so its step is finite.
TEST(VbdLaws, ASingularBlockIsRegularized) {
  Block<float> block;
  add_outer(block, 1e6f, Vec3f{0.6f, 0.0f, 0.8f});
  block.f = {0.0f, 1.0f, 0.0f};
  const Vec3f d = solve_block(factorize(block, 1e-6f), block.f);
  EXPECT_NEAR(d.y, 3.0f, 0.1f);
}

}  // namespace
}  // namespace novaphy::vbd
