// The block of Newton's diffsim_soft_body example: every bit of the model and of the rollout.
#include "golden_scene.h"
#include "support/soft_body_scene.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;
using testing::same_bits;

template <class T, class U>
void expect_bits(const DeviceArray<T>& array, const Npz& file, const char* name) {
  const std::vector<T> values = array.to_host();
  const auto expected = file[name].as<U>();
  ASSERT_EQ(values.size() * sizeof(T), expected.size_bytes()) << name;
  EXPECT_EQ(std::memcmp(values.data(), expected.data(), expected.size_bytes()), 0) << name;
}

TEST(NewtonSoftBody, TheModelIsNewtonsInAllBits) {
  const Npz file = golden("newton_soft_body_strict.npz");
  const auto model = testing::make_soft_body_model();
  testing::expect_model_arrays_equal(file, *model, 18);
  const Model& m = *model;
  expect_bits<Vec3i, int32_t>(m.particle_tri_indices, file, "model_tri_indices");
  expect_bits<Mat22f, float>(m.particle_tri_pose, file, "model_tri_poses");
  expect_bits<float, float>(m.particle_tri_area, file, "model_tri_areas");
  expect_bits<float, float>(m.particle_tri_material, file, "model_tri_materials");
  expect_bits<float, float>(m.particle_tri_activation, file, "model_tri_activations");
  expect_bits<Vec4i, int32_t>(m.particle_tet_indices, file, "model_tet_indices");
  expect_bits<Mat33f, float>(m.particle_tet_pose, file, "model_tet_poses");
  expect_bits<float, float>(m.particle_tet_material, file, "model_tet_materials");
  expect_bits<float, float>(m.particle_tet_activation, file, "model_tet_activations");
  expect_bits<Vec4i, int32_t>(m.particle_edge_indices, file, "model_edge_indices");
  expect_bits<float, float>(m.particle_edge_rest_angle, file, "model_edge_rest_angle");
  expect_bits<float, float>(m.particle_edge_material, file, "model_edge_bending_properties");
  EXPECT_EQ(testing::kSoftBodyDt, file["sim_dt"].scalar<float>());
}

// Every substep finds new contacts, as in the example.
TEST(NewtonSoftBody, TheRolloutIsNewtonsInAllBits) {
  const Npz file = golden("newton_soft_body_strict.npz");
  const auto run = testing::golden_run(testing::make_soft_body_model(), testing::kSoftBodyGap,
                                       testing::kSoftBodyDt, testing::kSoftBodySteps, true);
  const size_t n = 27, early = file["particle_q_first65"].size() / (3 * n);
  EXPECT_EQ(early, 65u);
  const std::span<const Vec3f> q = run.q, qd = run.qd;
  EXPECT_TRUE(same_bits(q.first(early * n), file["particle_q_first65"].as<Vec3f>()));
  EXPECT_TRUE(same_bits(qd.first(early * n), file["particle_qd_first65"].as<Vec3f>()));
  const auto frames = file["particle_q_frames"].as<Vec3f>();
  for (size_t frame = 0; frame <= 60; ++frame)
    EXPECT_TRUE(same_bits(q.subspan(frame * testing::kSoftBodySubsteps * n, n),
                          frames.subspan(frame * n, n)))
        << "frame " << frame;
  const auto centroids = file["centroid"].as<Vec3f>();
  ASSERT_EQ(centroids.size(), static_cast<size_t>(testing::kSoftBodySteps) + 1);
  size_t equal = 0;
  for (size_t t = 0; t < centroids.size(); ++t) {
    const Vec3f c = testing::centroid(q.subspan(t * n, n));
    equal += same_bits(std::span(&c, 1), centroids.subspan(t, 1));
  }
  EXPECT_EQ(equal, centroids.size());
  EXPECT_TRUE(same_bits(qd.last(n), file["particle_qd_final"].as<Vec3f>()));
}

}  // namespace
}  // namespace novaphy
