#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "novaphy/dynamics/semi_implicit/particle_integrator_trace.h"
#include "support/bits.h"

namespace novaphy {
namespace {

TEST(ParticleIntegrator, IsSymplecticEuler) {
  const auto next =
      integrate_particle(Vec3f{1.0f, 2.0f, 3.0f}, Vec3f{0.5f, 0.0f, -1.0f}, Vec3f{4.0f, 0.0f, 0.0f},
                         0.5f, Vec3f{0.0f, 0.0f, -8.0f}, 1e5f, 0.25f);
  EXPECT_EQ(next.qd, (Vec3f{1.0f, 0.0f, -3.0f}));
  EXPECT_EQ(next.q, (Vec3f{1.25f, 2.0f, 2.25f}));
}

TEST(ParticleIntegrator, LeavesAKinematicParticleOnItsCourse) {
  const auto next =
      integrate_particle(Vec3f{}, Vec3f{1.0f, 0.0f, 0.0f}, Vec3f{100.0f, 100.0f, 100.0f}, 0.0f,
                         Vec3f{0.0f, 0.0f, -9.81f}, 1e5f, 0.5f);
  EXPECT_EQ(next.qd, (Vec3f{1.0f, 0.0f, 0.0f}));
  EXPECT_EQ(next.q, (Vec3f{0.5f, 0.0f, 0.0f}));
}

TEST(ParticleIntegrator, LimitsTheSpeedAndKeepsTheDirection) {
  const auto next =
      integrate_particle(Vec3f{}, Vec3f{6.0f, 8.0f, 0.0f}, Vec3f{}, 1.0f, Vec3f{}, 5.0f, 1.0f);
  EXPECT_EQ(next.qd, (Vec3f{3.0f, 4.0f, 0.0f}));
  EXPECT_EQ(next.q, (Vec3f{3.0f, 4.0f, 0.0f}));
  // Exactly at the limit nothing happens.
  const auto at =
      integrate_particle(Vec3f{}, Vec3f{3.0f, 4.0f, 0.0f}, Vec3f{}, 1.0f, Vec3f{}, 5.0f, 1.0f);
  EXPECT_EQ(at.qd, (Vec3f{3.0f, 4.0f, 0.0f}));
  const auto rest = integrate_particle(Vec3f{}, Vec3f{}, Vec3f{}, 1.0f, Vec3f{}, 5.0f, 1.0f);
  EXPECT_EQ(rest.qd, (Vec3f{}));
}

TEST(ParticleIntegrator, KeepsEveryBitOfAnInactiveParticle) {
  const Vec3f x = {-0.0f, 1e-45f, std::numeric_limits<float>::infinity()}, v = {3.0f, -0.0f, 2.0f};
  const auto next =
      integrate_particle(false, x, v, Vec3f{1.0f, 1.0f, 1.0f}, 1.0f, Vec3f{}, 1.0f, 0.1f);
  EXPECT_TRUE(testing::same_bits(std::span(&next.q, 1), std::span(&x, 1)));
  EXPECT_TRUE(testing::same_bits(std::span(&next.qd, 1), std::span(&v, 1)));
}

}  // namespace
}  // namespace novaphy
