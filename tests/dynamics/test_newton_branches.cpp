// Small scenes with branches that the ball does not reach, run by Newton
// (tools/reference/make_newton_branches.py).
#include <algorithm>
#include <set>

#include "golden_scene.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;
using testing::same_bits;

testing::GoldenRun run_file(const Npz& file) {
  return testing::golden_run(testing::golden_model(file), file["soft_contact_gap"].scalar<float>(),
                             file["sim_dt"].scalar<float>(), file["sim_steps"].scalar<int32_t>(),
                             file["regenerate"].scalar<int32_t>() != 0);
}

class NewtonBranches : public ::testing::TestWithParam<const char*> {};

// The scene "inactive" is included. Newton does not write the velocity of an inactive particle, so
// its output state keeps the initial velocity. This solver copies the velocity. The bits are the
// same.
TEST_P(NewtonBranches, EqualNewtonInAllBits) {
  const Npz file = golden("newton_" + std::string(GetParam()) + ".npz");
  testing::expect_model_arrays_equal(file, *testing::golden_model(file), 15);
  const auto run = run_file(file);
  const auto expected = testing::golden_contacts(file);
  EXPECT_TRUE(same_bits(std::span<const SoftContact>(run.contacts),
                        std::span<const SoftContact>(expected)));
  EXPECT_TRUE(same_bits(std::span<const int32_t>(run.contact_counts),
                        file["contact_counts"].as<int32_t>()));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.q), file["particle_q"].as<Vec3f>()));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.qd), file["particle_qd"].as<Vec3f>()));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.f), file["particle_f"].as<Vec3f>()));
}

INSTANTIATE_TEST_SUITE_P(Scenes, NewtonBranches,
                         ::testing::Values("friction", "tilted", "tilted_regenerated",
                                           "box_interior", "box_interior_regenerated", "walls",
                                           "velocity_clamp", "inactive", "shape_flags",
                                           "sphere_capsule", "sphere_capsule_regenerated"),
                         [](const auto& scene) { return std::string(scene.param); });

// Newton's finite plane is unsigned, and its contact point may lie beside the sheet (a defect).
// Here a finite plane is the top of a solid block. So the test compares only particles above the
// sheets, and particles that meet no finite plane.
TEST(NewtonFinitePlane, EqualsNewtonAboveTheSheet) {
  const Npz file = golden("newton_finite_plane.npz");
  const auto run = run_file(file);
  const std::set<size_t> same = {0, 1, 2, 3, 8, 9, 12, 13, 14};
  const size_t count = file["model_particle_mass"].size();
  for (const auto& [name, values] :
       {std::pair{"particle_q", &run.q}, {"particle_qd", &run.qd}, {"particle_f", &run.f}}) {
    const auto expected = file[name].as<Vec3f>();
    ASSERT_EQ(values->size(), expected.size());
    for (size_t i = 0; i < expected.size(); ++i) {
      if (!same.contains(i % count)) continue;
      EXPECT_TRUE(same_bits(std::span(&(*values)[i], 1), std::span(&expected[i], 1)))
          << name << " of particle " << i % count << " in state " << i / count;
    }
  }
}

// Particle 7 starts 0.05 m below the flat sheet. Newton mirrors the contact point to the other side
// of the particle. Here the contact pushes the particle out through the top.
TEST(NewtonFinitePlane, PushesAParticleBelowTheSheetUp) {
  const Npz file = golden("newton_finite_plane.npz");
  const auto run = run_file(file);
  const auto contact =
      std::find_if(run.contacts.begin(), run.contacts.end(),
                   [](const SoftContact& c) { return c.particle == 7 && c.shape == 0; });
  ASSERT_NE(contact, run.contacts.end());
  EXPECT_FLOAT_EQ(contact->body_pos.z, 0.5f);
  EXPECT_EQ(contact->normal, (Vec3f{0.0f, 0.0f, 1.0f}));
  const size_t count = file["model_particle_mass"].size();
  EXPECT_GT(run.f[7].z, 1000.0f);
  EXPECT_GT(run.q[40 * count + 7].z, 0.5f);
}

}  // namespace
}  // namespace novaphy
