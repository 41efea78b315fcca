// Worlds of a ModelBuilder. The numbers are those of Newton 1.8.0's ModelBuilder.
#include <gtest/gtest.h>

#include <cmath>

#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"

namespace novaphy {
namespace {

ModelBuilder ball_over_a_plane() {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 1.0f}, {1.0f, 0.0f, 0.0f}, 2.0f);
  builder.add_ground_plane();
  return builder;
}

TEST(Worlds, WhatIsAddedInAWorldBelongsToItAndTheRestToAll) {
  ModelBuilder builder;
  builder.add_ground_plane();
  EXPECT_EQ(builder.begin_world(), 0);
  EXPECT_EQ(builder.current_world(), 0);
  builder.add_particle({}, {}, 1.0f);
  builder.add_shape_sphere(-1);
  builder.end_world();
  EXPECT_EQ(builder.begin_world(Vec3f{1.0f, 2.0f, 3.0f}), 1);
  const Vec3f at[] = {{}}, still[] = {{}};
  const float mass[] = {1.0f};
  builder.add_particles(at, still, mass);
  builder.end_world();
  EXPECT_EQ(builder.current_world(), -1);

  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->world_count(), 2);
  EXPECT_EQ(model->particle_world.to_host(), (std::vector<int32_t>{0, 1}));
  EXPECT_EQ(model->shape_world.to_host(), (std::vector<int32_t>{-1, 0}));
  EXPECT_EQ(model->gravity.to_host(),
            (std::vector<Vec3f>{{0.0f, 0.0f, -9.81f}, {1.0f, 2.0f, 3.0f}}));
  model->set_gravity({4.0f, 5.0f, 6.0f}, 0);
  EXPECT_EQ(model->gravity.to_host(), (std::vector<Vec3f>{{4.0f, 5.0f, 6.0f}, {1.0f, 2.0f, 3.0f}}));
}

TEST(Worlds, ABuilderWithoutWorldsMakesOne) {
  const auto model = ball_over_a_plane().finalize(Device::cpu());
  EXPECT_EQ(model->world_count(), 1);
  EXPECT_EQ(model->gravity.rows(), 1u);
}

TEST(Worlds, AddBuilderMovesAndTurnsWhatItAdds) {
  ModelBuilder part;
  part.add_particle({1.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, 1.0f);
  part.add_particle({2.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 3.0f}, 2.0f);
  part.add_spring(0, 1, 10.0f, 1.0f);
  part.add_shape_sphere(-1, {.radius = 0.5f});
  part.add_shape_box(-1, {});
  part.add_shape_collision_filter_pair(0, 1);
  ModelBuilder scene;
  scene.add_particle({}, {}, 1.0f);
  scene.add_ground_plane();
  const float half = std::sqrt(0.5f);
  scene.add_builder(part,
                    {{0.0f, 0.0f, 5.0f}, {0.0f, 0.0f, half, half}});  // a quarter turn about z

  ASSERT_EQ(scene.particle_count(), 3);
  EXPECT_NEAR(scene.particle_q[1].x, 0.0f, 1e-6f);
  EXPECT_NEAR(scene.particle_q[1].y, 1.0f, 1e-6f);
  EXPECT_EQ(scene.particle_q[1].z, 5.0f);
  EXPECT_NEAR(scene.particle_qd[1].y, 1.0f, 1e-6f);
  EXPECT_FLOAT_EQ(scene.particle_qd[2].z, 3.0f);
  EXPECT_EQ(scene.particle_mass[2], 2.0f);
  const auto model = scene.finalize(Device::cpu());
  EXPECT_EQ(model->particle_spring_indices.to_host(), (std::vector<Vec2i>{{1, 2}}));
  EXPECT_EQ(model->particle_spring_rest_length.to_host(), std::vector<float>{1.0f});
  EXPECT_EQ(model->shape_transform.to_host()[1].p, (Vec3f{0.0f, 0.0f, 5.0f}));
  EXPECT_EQ(model->shape_transform.to_host()[1].q, (Quatf{0.0f, 0.0f, half, half}));
  EXPECT_TRUE(model->shape_collision_filter_pairs.contains({1, 2}));
}

TEST(Worlds, WhatIsNotMovedKeepsItsBits) {
  ModelBuilder part;
  part.add_particle({-0.0f, 0.1f, 0.3f}, {-0.0f, 0.7f, 1e-40f}, 1.0f);
  ModelBuilder scene;
  scene.add_world(part);
  EXPECT_TRUE(std::signbit(scene.particle_q[0].x));
  EXPECT_TRUE(std::signbit(scene.particle_qd[0].x));
  EXPECT_EQ(scene.particle_qd[0].z, 1e-40f);
}

TEST(Worlds, AWorldHasTheGravityOfTheBuilderThatIsAdded) {
  ModelBuilder moon(Axis::Z, -1.62f), scene;
  moon.add_particle({}, {}, 1.0f);
  EXPECT_EQ(scene.add_world(moon), 0);
  scene.begin_world();
  scene.add_particle({}, {}, 1.0f);
  scene.end_world();
  EXPECT_EQ(scene.finalize(Device::cpu())->gravity.to_host(),
            (std::vector<Vec3f>{{0.0f, 0.0f, -1.62f}, {0.0f, 0.0f, -9.81f}}));
  ModelBuilder one;
  one.add_builder(moon);
  EXPECT_EQ(one.gravity, (Vec3f{0.0f, 0.0f, -1.62f}));
}

TEST(Worlds, ReplicateSetsWorldsOnNewtonsGrid) {
  const auto offsets = [](int32_t count, const Vec3f& spacing) {
    ModelBuilder scene;
    ModelBuilder part;
    part.add_particle({}, {}, 1.0f);
    scene.replicate(part, count, spacing);
    EXPECT_EQ(scene.world_count(), count);
    return scene.particle_q;
  };
  EXPECT_EQ(offsets(3, {2.0f, 0.0f, 0.0f}),
            (std::vector<Vec3f>{{-2.0f, 0.0f, 0.0f}, {}, {2.0f, 0.0f, 0.0f}}));
  EXPECT_EQ(offsets(2, {}), (std::vector<Vec3f>(2)));
  EXPECT_EQ(offsets(3, {1.0f, 4.0f, 0.0f}),
            (std::vector<Vec3f>{{-0.5f, -2.0f, 0.0f}, {0.5f, -2.0f, 0.0f}, {-0.5f, 2.0f, 0.0f}}));
  EXPECT_EQ(offsets(2, {0.0f, 0.0f, 3.0f}),  // along the up axis from 0
            (std::vector<Vec3f>{{}, {0.0f, 0.0f, 3.0f}}));
  EXPECT_EQ(offsets(0, {1.0f, 1.0f, 1.0f}), std::vector<Vec3f>());
}

TEST(Worlds, AnErrorLeavesTheBuilderAsItWas) {
  ModelBuilder scene;
  const ModelBuilder part = ball_over_a_plane();
  const Transformf bent{{}, {0.0f, 0.0f, 0.0f, 2.0f}};
  EXPECT_ERROR(scene.end_world(), ErrorKind::Runtime, "end_world: no world is open");
  EXPECT_ERROR(scene.add_world(part, bent), ErrorKind::Value, "add_world: xform.q");
  EXPECT_ERROR(scene.add_builder(scene), ErrorKind::Value,
               "expected another builder, got this one");
  EXPECT_ERROR(scene.add_world(ModelBuilder(Axis::Y)), ErrorKind::Value, "up axis 2, got 1");
  EXPECT_ERROR(scene.replicate(part, -1), ErrorKind::Value, "world_count: expected >= 0, got -1");
  EXPECT_EQ(scene.world_count(), 0);
  EXPECT_EQ(scene.particle_count() + scene.shape_count(), 0);
  scene.begin_world();
  EXPECT_ERROR(scene.begin_world(), ErrorKind::Runtime, "begin_world: world 0 is open");
  EXPECT_ERROR(scene.replicate(part, 2), ErrorKind::Runtime, "replicate: world 0 is open");
  EXPECT_ERROR(scene.finalize(Device::cpu()), ErrorKind::Runtime, "finalize: world 0 is open");
  scene.end_world();
  EXPECT_EQ(scene.world_count(), 1);
}

TEST(Worlds, AParticleOfAllWorldsNeedsTheGravityOfTheLast) {
  ModelBuilder scene;
  scene.add_particle({}, {}, 1.0f);
  scene.begin_world(Vec3f{1.0f, 0.0f, 0.0f});
  scene.end_world();
  EXPECT_ERROR(scene.finalize(Device::cpu()), ErrorKind::Value,
               "particle_world[0]: expected a world from 0");
  scene.gravity = {1.0f, 0.0f, 0.0f};
  EXPECT_EQ(scene.finalize(Device::cpu())->particle_world.to_host(), std::vector<int32_t>{-1});
  scene.particle_world[0] = 1;
  EXPECT_ERROR(scene.finalize(Device::cpu()), ErrorKind::Value,
               "expected -1 (all worlds) to 0, got 1");
}

}  // namespace
}  // namespace novaphy
