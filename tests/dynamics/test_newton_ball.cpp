// The ball of Newton's diffsim_ball example: every bit of the model, the contacts and all 289
// states.
#include "golden_scene.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;
using testing::same_bits;

// Written as a user would, not from the file.
std::shared_ptr<Model> ball() {
  ModelBuilder builder;
  const ShapeConfig cfg = {.ke = 1e4f, .kd = 10.0f, .kf = 0.0f, .mu = 0.2f};
  builder.add_particle({0.0f, -0.5f, 1.0f}, {0.0f, 5.0f, -5.0f}, 1.0f);
  builder.add_shape_box(-1, {.xform = {{0.0f, 2.0f, 1.0f}, Quatf::identity()},
                             .hx = 1.0f,
                             .hy = 0.25f,
                             .hz = 1.0f,
                             .cfg = cfg});
  builder.add_ground_plane({.cfg = cfg});
  auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 1e4f;
  model->soft_contact_kd = 10.0f;
  model->soft_contact_kf = 0.0f;
  model->soft_contact_mu = 0.2f;
  model->soft_contact_restitution = 1.0f;
  return model;
}

constexpr int kSteps = 288;
constexpr float kDt = static_cast<float>(1.0 / 60.0 / 8.0);

TEST(NewtonBall, TheModelIsNewtonsInAllBits) {
  const Npz file = golden("newton_ball_strict.npz");
  const auto model = ball();
  testing::expect_model_arrays_equal(file, *model, 22);
  EXPECT_EQ(model->particle_max_radius, file["model_particle_max_radius"].scalar<float>());
  EXPECT_EQ(model->particle_max_velocity, file["model_particle_max_velocity"].scalar<float>());
  EXPECT_EQ(model->particle_adhesion, file["model_particle_adhesion"].scalar<float>());
  EXPECT_EQ(model->soft_contact_restitution,
            file["model_soft_contact_restitution"].scalar<float>());
  EXPECT_EQ(kDt, file["sim_dt"].scalar<float>());
}

TEST(NewtonBall, ContactsAndAllStatesAreNewtonsInAllBits) {
  const Npz file = golden("newton_ball_strict.npz");
  const auto run = testing::golden_run(ball(), 10.0f, kDt, kSteps, false);
  const auto expected = testing::golden_contacts(file);
  EXPECT_EQ(expected.size(), 2u);
  EXPECT_TRUE(same_bits(std::span<const SoftContact>(run.contacts),
                        std::span<const SoftContact>(expected)));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.q), file["particle_q"].as<Vec3f>()));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.qd), file["particle_qd"].as<Vec3f>()));
  EXPECT_TRUE(same_bits(std::span<const Vec3f>(run.f), file["particle_f"].as<Vec3f>()));
  const Vec3f delta = run.q.back() - file["target"].as<Vec3f>()[0];
  EXPECT_EQ(math::dot(delta, delta), file["loss"].scalar<float>());
}

}  // namespace
}  // namespace novaphy
