// The laws of VBD in double precision: forces are minus the derivative of the stated energies, the
// Hessians what the headers say of them.
#include <gtest/gtest.h>

#include <random>

#include "novaphy/vbd/bending_law.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "novaphy/vbd/spring_law.h"
#include "novaphy/vbd/tetrahedron_law.h"
#include "real64.h"

namespace novaphy::vbd {
namespace {

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

TEST(VbdLaws, ASpringsForceIsMinusTheDerivativeOfItsEnergy) {
  for (int trial = 0; trial < 100; ++trial) {
    const Point x = random_point(), other = random_point();
    const SpringLaw<Real64> law = {random(0, 100), random(0, 10), random(0.1, 2)};
    const Real64 start = random(0.1, 2);
    const auto block = spring_block(x, other, law, start);
    expect_force(block,
                 gradient([&](const Point& p) { return spring_energy(p, other, law, start); }, x));
    expect_semidefinite(block);
    const auto force = [&](const Point& p) { return spring_block(p, other, law, start).f; };
    // Without the projection H lacks only what the damper's turning adds.
    const SpringLaw<Real64> undamped = {law.ke, Real64(0.0), law.rest};
    const auto elastic = [&](const Point& p) { return spring_block(p, other, undamped, start).f; };
    expect_exact(spring_block<false>(x, other, undamped, start), elastic, x);
    if (spring_length(x, other) > law.rest)
      expect_exact(spring_block(x, other, undamped, start), elastic, x);
    EXPECT_LT(math::length(force(x) + spring_block(other, x, law, start).f).v, 1e-9);
  }
}

// A spring that is pressed to half its length has an indefinite second derivative; H does not.
TEST(VbdLaws, APressedSpringIsProjected) {
  const Point x = {Real64(0.5), Real64(0.0), Real64(0.0)};
  const SpringLaw<Real64> law = {Real64(10.0), Real64(0.0), Real64(1.0)};
  const auto exact = spring_block<false>(x, Point{}, law, Real64(1.0));
  const auto used = spring_block(x, Point{}, law, Real64(1.0));
  EXPECT_DOUBLE_EQ(exact.h11.v, -10.0);
  EXPECT_DOUBLE_EQ(used.h11.v, 0.0);
  EXPECT_DOUBLE_EQ(used.h00.v, exact.h00.v);
}

TEST(VbdLaws, AMembranesForceIsMinusTheDerivativeOfItsEnergy) {
  int extended = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Point x = random_point(), x1 = random_point(), x2 = random_point();
    const MembraneWeights<Real64> w = {{random(-2, 2), random(-2, 2)},
                                       {random(-2, 2), random(-2, 2)}};
    const Real64 kd = trial % 2 == 0 ? Real64(0.0) : random(0, 5);
    const auto law =
        membrane_law(random(0.1, 1), random(0, 100), random(0, 100), random(-0.5, 0.5), kd);
    const auto start = membrane_strain(near(x, 0.1), near(x1, 0.1), near(x2, 0.1), w);
    const auto block = membrane_block(x, x1, x2, w, law, start, true);
    expect_force(
        block,
        gradient([&](const Point& p) { return membrane_energy(p, x1, x2, w, law, start); }, x));
    expect_semidefinite(block);
    if (kd.v != 0.0) continue;
    const auto shape = membrane_detail::shape(x, x1, x2, w);
    if (shape.area_ratio < law.alpha) continue;
    ++extended;
    expect_exact(
        block, [&](const Point& p) { return membrane_block(p, x1, x2, w, law, start, false).f; },
        x);
  }
  EXPECT_GT(extended, 20);
}

TEST(VbdLaws, ATetrahedronsForceAndHessianAreTheDerivativesOfItsEnergy) {
  int inverted = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Point x = random_point(), x1 = random_point(), x2 = random_point(), x3 = random_point();
    const TetrahedronWeights<Real64> w = {random_point(2), random_point(2), random_point(2)};
    const Real64 kd = trial % 2 == 0 ? Real64(0.0) : random(0, 5);
    const auto law =
        tetrahedron_law(random(0.1, 1), random(0.1, 100), random(0, 100), random(-0.5, 0.5), kd);
    const auto start =
        tetrahedron_strain(near(x, 0.1), near(x1, 0.1), near(x2, 0.1), near(x3, 0.1), w);
    const auto block = tetrahedron_block(x, x1, x2, x3, w, law, start, true);
    expect_force(
        block,
        gradient([&](const Point& p) { return tetrahedron_energy(p, x1, x2, x3, w, law, start); },
                 x));
    expect_semidefinite(block);
    const auto g = tetrahedron_detail::gradient(x, x1, x2, x3, w);
    inverted += math::dot(g.f[0], math::cross(g.f[1], g.f[2])).v < 0.0;
    if (kd.v != 0.0) continue;
    expect_exact(
        block,
        [&](const Point& p) { return tetrahedron_block(p, x1, x2, x3, w, law, start, false).f; },
        x);
  }
  EXPECT_GT(inverted, 50);
}

TEST(VbdLaws, ABendingEdgesForceIsMinusTheDerivativeOfItsEnergy) {
  for (int trial = 0; trial < 100; ++trial) {
    const Real64 zero, one(1.0);
    const Point x0 = near({zero, one, zero}, 0.4), x1 = near({zero, -one, zero}, 0.4);
    const Point x2 = near({-one, zero, zero}, 0.4), x3 = near({one, zero, zero}, 0.4);
    const BendingLaw<Real64> law = {random(0, 10), random(0, 2), random(-1, 1)};
    const Real64 start = random(-0.5, 0.5);
    const auto opposite = bending_opposite_block(x0, x1, x2, x3, law, start);
    const auto end = bending_end_block(x0, x1, x2, x3, law, start);
    expect_force(
        opposite,
        gradient([&](const Point& p) { return bending_energy(p, x1, x2, x3, law, start); }, x0));
    expect_force(
        end,
        gradient([&](const Point& p) { return bending_energy(x0, x1, p, x3, law, start); }, x2));
    expect_semidefinite(opposite);
    expect_semidefinite(end);
    // The four forces balance; the other two are those of the edge read from its other side.
    const Point sum = (opposite.f + end.f) + (bending_opposite_block(x1, x0, x3, x2, law, start).f +
                                              bending_end_block(x1, x0, x3, x2, law, start).f);
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
  const auto degenerate = bending_end_block<float>(a, a, b, b, {1.0f, 1.0f, 0.0f}, 0.0f);
  EXPECT_EQ(math::length(degenerate.f) + degenerate.h00, 0.0f);
}

// Within its rounding a singular block gets the regularization, and a step that is not NaN.
TEST(VbdLaws, ASingularBlockIsRegularized) {
  Block<float> block;
  add_outer(block, 1e6f, Vec3f{0.6f, 0.0f, 0.8f});
  block.f = {0.0f, 1.0f, 0.0f};
  const Vec3f d = solve_block(factorize(block, 1e-6f), block.f);
  EXPECT_NEAR(d.y, 3.0f, 0.1f);
}

}  // namespace
}  // namespace novaphy::vbd
