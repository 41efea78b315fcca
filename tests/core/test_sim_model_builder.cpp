#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/sim/shape_pair_rules.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

TEST(ModelBuilder, KeepsWhatIsAdded) {
  ModelBuilder builder;
  EXPECT_EQ(builder.add_particle({1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}, 4.0f), 0);
  EXPECT_EQ(builder.add_particle({}, {}, 0.0f, 0.5f, 0), 1);
  EXPECT_EQ(builder.add_shape_box(
                -1, {.xform = {{0.0f, 2.0f, 1.0f}, Quatf::identity()}, .hx = 1.0f, .hy = 0.25f}),
            0);
  EXPECT_EQ(builder.add_ground_plane(), 1);
  EXPECT_EQ(builder.add_shape_sphere(-1, {.radius = 0.25f, .label = "ball"}), 2);
  EXPECT_EQ(builder.add_shape_capsule(-1, {.radius = 0.25f, .half_height = 1.0f}), 3);
  const auto model = builder.finalize(Device::cpu(), {.requires_grad = true});

  EXPECT_EQ(model->particle_count(), 2);
  EXPECT_EQ(model->shape_count(), 4);
  EXPECT_EQ(model->body_count(), 0);
  EXPECT_EQ(model->world_count(), 1);
  EXPECT_EQ(model->particle_mass.to_host(), (std::vector<float>{4.0f, 0.0f}));
  EXPECT_EQ(model->particle_inv_mass.to_host(), (std::vector<float>{0.25f, 0.0f}));
  EXPECT_EQ(model->particle_radius.to_host(), (std::vector<float>{0.1f, 0.5f}));
  EXPECT_EQ(model->particle_flags.to_host(), (std::vector<int32_t>{1, 0}));
  EXPECT_EQ(model->particle_world.to_host(), (std::vector<int32_t>{-1, -1}));
  EXPECT_EQ(model->particle_max_radius, 0.5f);
  EXPECT_EQ(model->shape_type.to_host(), (std::vector<int32_t>{7, 1, 3, 4}));
  EXPECT_EQ(
      model->shape_scale.to_host(),
      (std::vector<Vec3f>{{1.0f, 0.25f, 0.5f}, {}, {0.25f, 0.0f, 0.0f}, {0.25f, 1.0f, 0.0f}}));
  EXPECT_EQ(model->shape_body.to_host(), (std::vector<int32_t>(4, -1)));
  EXPECT_EQ(model->shape_flags.to_host(), (std::vector<int32_t>(4, 7)));
  EXPECT_EQ(model->shape_gap.to_host(), (std::vector<float>(4, 0.1f)));
  EXPECT_EQ(model->shape_label,
            (std::vector<std::string>{"shape_0", "ground_plane", "ball", "shape_3"}));
  EXPECT_EQ(model->gravity.to_host(), (std::vector<Vec3f>{{-0.0f, -0.0f, -9.81f}}));
  EXPECT_TRUE(model->requires_grad);
  EXPECT_EQ(model->shape_contact_pairs().rows(), 0u);
}

// Newton 1.8.0's shape_collision_radius for the same shapes.
TEST(ModelBuilder, BoundsEqualNewtons) {
  ModelBuilder builder;
  builder.add_ground_plane();
  builder.add_shape_plane({.width = 2.0f, .length = 3.0f});
  builder.add_shape_box(-1, {.hx = 1.0f, .hy = 0.25f, .hz = 2.0f});
  builder.add_shape_sphere(-1, {.radius = 0.5f});
  builder.add_shape_capsule(-1, {.radius = 0.5f, .half_height = 0.7f});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->shape_collision_radius.to_host(),
            (std::vector<float>{1e6f, 1.8027756f, 2.25f, 0.5f, 1.2f}));
  const auto lower = model->shape_aabb_lower.to_host();
  const auto upper = model->shape_aabb_upper.to_host();
  EXPECT_EQ(upper[1], (Vec3f{1.0f, 1.5f, 0.0f}));
  EXPECT_EQ(lower[2], (Vec3f{-1.0f, -0.25f, -2.0f}));
  EXPECT_EQ(upper[4], (Vec3f{0.5f, 0.5f, 1.2f}));
  EXPECT_EQ(lower[4], (Vec3f{-0.5f, -0.5f, -1.2f}));
}

// The poses are Newton 1.8.0's, except for the last: Newton leaves a plane with the normal -z
// unrotated.
TEST(ModelBuilder, PlanesPointAlongTheirNormal) {
  struct Case {
    Axis up;
    float height;
    Transformf pose;
  };
  const float h = 0.70710677f;
  for (const Case& c : {Case{Axis::Z, 0.75f, {{0.0f, 0.0f, 0.75f}, {0.0f, 0.0f, 0.0f, 1.0f}}},
                        Case{Axis::Y, 0.75f, {{0.0f, 0.75f, 0.0f}, {-h, 0.0f, 0.0f, h}}},
                        Case{Axis::X, 0.75f, {{0.75f, 0.0f, 0.0f}, {0.0f, h, 0.0f, h}}}}) {
    ModelBuilder builder(c.up);
    builder.add_ground_plane({.height = c.height});
    const auto pose = builder.finalize(Device::cpu())->shape_transform.to_host();
    EXPECT_TRUE(testing::same_bits(std::span<const Transformf>(pose), std::span(&c.pose, 1)));
  }
  ModelBuilder builder;
  builder.add_shape_plane({.plane = {0.3f, -0.2f, 0.7f, 0.4f}});
  builder.add_shape_plane({.plane = {0.0f, 0.0f, -2.0f, -0.5f}});
  builder.add_shape_plane({.plane = {1e-5f, 0.0f, -1.0f, 0.0f}});
  const auto poses = builder.finalize(Device::cpu())->shape_transform.to_host();
  const Vec3f tilted = math::rotate(poses[0].q, Vec3f{0.0f, 0.0f, 1.0f});
  EXPECT_NEAR(tilted.x, 0.3 / std::sqrt(0.62), 1e-6);
  EXPECT_NEAR(tilted.y, -0.2 / std::sqrt(0.62), 1e-6);
  EXPECT_NEAR(tilted.z, 0.7 / std::sqrt(0.62), 1e-6);
  EXPECT_NEAR(poses[0].p.x, -0.19354838f, 1e-7);
  EXPECT_NEAR(poses[0].p.z, -0.4516129f, 1e-7);
  EXPECT_EQ(math::rotate(poses[1].q, Vec3f{0.0f, 0.0f, 1.0f}), (Vec3f{0.0f, 0.0f, -1.0f}));
  EXPECT_EQ(poses[1].p, (Vec3f{0.0f, 0.0f, -0.25f}));
  EXPECT_NEAR(math::rotate(poses[2].q, Vec3f{0.0f, 0.0f, 1.0f}).x, 1e-5, 1e-9);
}

TEST(ModelBuilder, GravityIsANumberAlongUpOrAVector) {
  EXPECT_EQ(ModelBuilder(Axis::Y).gravity, (Vec3f{0.0f, -9.81f, 0.0f}));
  EXPECT_EQ(ModelBuilder(Axis::X, -2.0f).gravity, (Vec3f{-2.0f, 0.0f, 0.0f}));
  EXPECT_EQ(ModelBuilder(Axis::Z, Vec3f{1.0f, 2.0f, 3.0f}).gravity, (Vec3f{1.0f, 2.0f, 3.0f}));
  EXPECT_ERROR(ModelBuilder(Axis::Z, kNan), ErrorKind::Value, "gravity: expected finite numbers");
  EXPECT_ERROR(ModelBuilder(static_cast<Axis>(3)), ErrorKind::Value,
               "up_axis: expected X, Y or Z, got 3");
}

TEST(ModelBuilder, RefusesBadParticlesAndKeepsNothingOfThem) {
  ModelBuilder builder;
  EXPECT_ERROR(builder.add_particle({kNan, 0.0f, 0.0f}, {}, 1.0f), ErrorKind::Value,
               "pos: expected finite");
  EXPECT_ERROR(builder.add_particle({}, {0.0f, kInf, 0.0f}, 1.0f), ErrorKind::Value,
               "vel: expected finite");
  EXPECT_ERROR(builder.add_particle({}, {}, -1.0f), ErrorKind::Value,
               "mass: expected a finite number >= 0, got -1");
  EXPECT_ERROR(builder.add_particle({}, {}, kNan), ErrorKind::Value, "mass: expected");
  EXPECT_ERROR(builder.add_particle({}, {}, kInf), ErrorKind::Value, "mass: expected");
  EXPECT_ERROR(builder.add_particle({}, {}, 1e-39f), ErrorKind::Value, "inverse is finite");
  EXPECT_ERROR(builder.add_particle({}, {}, 1.0f, -0.1f), ErrorKind::Value, "radius: expected");
  EXPECT_ERROR(builder.add_particle({}, {}, 1.0f, kNan), ErrorKind::Value, "radius: expected");
  EXPECT_ERROR(builder.add_particle({}, {}, 1.0f, {}, 2), ErrorKind::Value, "flags: expected 0 or");
  builder.default_particle_radius = kInf;
  EXPECT_ERROR(builder.add_particle({}, {}, 1.0f), ErrorKind::Value,
               "default_particle_radius: expected");
  EXPECT_EQ(builder.particle_count(), 0);
  EXPECT_TRUE(builder.particle_mass.empty() && builder.particle_radius.empty() &&
              builder.particle_flags.empty());
}

TEST(ModelBuilder, AddsManyParticlesOrNone) {
  ModelBuilder builder;
  const std::vector<Vec3f> pos = {{}, {1.0f, 0.0f, 0.0f}, {2.0f, 0.0f, 0.0f}}, vel(3);
  const std::vector<float> mass = {1.0f, 2.0f, 0.0f}, radius = {0.1f, 0.2f, 0.3f};
  builder.add_particles(pos, vel, mass);
  builder.add_particles(pos, vel, mass, radius, std::vector<int32_t>{1, 0, 1});
  EXPECT_EQ(builder.particle_count(), 6);
  EXPECT_EQ(builder.particle_radius[2], 0.1f);
  EXPECT_EQ(builder.particle_radius[5], 0.3f);
  EXPECT_EQ(builder.particle_flags[4], 0);
  builder.add_particles({}, {}, {});
  EXPECT_EQ(builder.particle_count(), 6);

  EXPECT_ERROR(builder.add_particles(pos, std::vector<Vec3f>(2), mass), ErrorKind::Value,
               "vel: expected 3 elements");
  EXPECT_ERROR(builder.add_particles(pos, vel, mass, std::vector<float>(1)), ErrorKind::Value,
               "radius: expected 3");
  EXPECT_ERROR(builder.add_particles(pos, vel, std::vector<float>{1.0f, -1.0f, 1.0f}),
               ErrorKind::Value, "mass[1]: expected a finite number >= 0, got -1");
  EXPECT_EQ(builder.particle_count(), 6);
}

TEST(ModelBuilder, RefusesBadShapesAndKeepsNothingOfThem) {
  ModelBuilder builder;
  EXPECT_ERROR(builder.add_shape_box(-1, {.hx = 0.0f}), ErrorKind::Value,
               "add_shape_box: scale.x (hx)");
  EXPECT_ERROR(builder.add_shape_box(-1, {.hz = -1.0f}), ErrorKind::Value, "scale.z (hz)");
  EXPECT_ERROR(builder.add_shape_sphere(-1, {.radius = -1.0f}), ErrorKind::Value, "radius");
  EXPECT_ERROR(builder.add_shape_sphere(-1, {.radius = kNan}), ErrorKind::Value,
               "scale.x (radius): expected a finite number > 0");
  EXPECT_ERROR(builder.add_shape_capsule(-1, {.half_height = 0.0f}), ErrorKind::Value,
               "half_height");
  EXPECT_ERROR(builder.add_shape_plane({.width = -1.0f}), ErrorKind::Value, "width");
  EXPECT_ERROR(builder.add_shape_plane({.plane = {}}), ErrorKind::Value, "not zero");
  EXPECT_ERROR(builder.add_shape_plane({.plane = {1.0f, 0.0f, 0.0f, kNan}}), ErrorKind::Value,
               "plane: expected");
  EXPECT_ERROR(builder.add_ground_plane({.height = kInf}), ErrorKind::Value,
               "add_ground_plane: height: expected a finite number");
  EXPECT_ERROR(builder.add_shape_box(-1, {.xform = {{kNan, 0.0f, 0.0f}, Quatf::identity()}}),
               ErrorKind::Value, "xform.p: expected finite");
  EXPECT_ERROR(builder.add_shape_box(-1, {.xform = {{}, {0.0f, 0.0f, 0.0f, 1.01f}}}),
               ErrorKind::Value, "xform.q: expected a quaternion of length 1");
  EXPECT_ERROR(builder.add_shape_box(-1, {.xform = {{}, {0.0f, 0.0f, kNan, 1.0f}}}),
               ErrorKind::Value, "xform.q");
  EXPECT_ERROR(builder.add_shape_box(-1, {.xform = {{}, {}}}), ErrorKind::Value, "xform.q");
  EXPECT_ERROR(builder.add_shape_box(0), ErrorKind::Index, "out of range");
  EXPECT_ERROR(builder.add_shape_box(-2), ErrorKind::Index, "body: expected -1");
  EXPECT_ERROR(builder.add_shape({.scale = {1.0f, 1.0f, 1.0f}}), ErrorKind::Value, "got NONE");
  EXPECT_ERROR(builder.add_shape({.type = GeoType::HFIELD}), ErrorKind::NotImplemented,
               "HFIELD is not supported");
  EXPECT_ERROR(builder.add_shape({.type = GeoType::MESH}), ErrorKind::Value, "MESH needs vertices");
  EXPECT_ERROR(builder.add_shape({.type = static_cast<GeoType>(42)}), ErrorKind::Value, "got 42");
  for (auto edit :
       {+[](ShapeConfig& c) { c.ke = kNan; }, +[](ShapeConfig& c) { c.kd = -1.0f; },
        +[](ShapeConfig& c) { c.kf = kInf; }, +[](ShapeConfig& c) { c.mu = -0.1f; },
        +[](ShapeConfig& c) { c.margin = kNan; }, +[](ShapeConfig& c) { c.gap = -1.0f; },
        +[](ShapeConfig& c) { c.density = kInf; }, +[](ShapeConfig& c) { c.restitution = kNan; }}) {
    ShapeConfig cfg;
    edit(cfg);
    EXPECT_ERROR(builder.add_shape_box(-1, {.cfg = cfg}), ErrorKind::Value, "cfg.");
  }
  builder.rigid_gap = kNan;
  EXPECT_ERROR(builder.add_shape_box(-1), ErrorKind::Value, "rigid_gap");
  EXPECT_EQ(builder.shape_count(), 0);
}

TEST(ModelBuilder, NormalizesQuaternionsOnce) {
  ModelBuilder builder;
  const Quatf unit = {0.18257418f, 0.36514837f, 0.5477226f, 0.73029673f};
  const Quatf longer = {unit.x * 1.0005f, unit.y * 1.0005f, unit.z * 1.0005f, unit.w * 1.0005f};
  builder.add_shape_box(-1, {.xform = {{}, unit}});
  builder.add_shape_box(-1, {.xform = {{}, longer}});
  builder.add_shape_box(-1, {.xform = {{-0.0f, 1.0f, 0.0f}, Quatf::identity()}});
  const auto poses = builder.finalize(Device::cpu())->shape_transform.to_host();
  EXPECT_TRUE(testing::same_bits(std::span(&poses[0].q, 1), std::span(&unit, 1)));
  EXPECT_NEAR(poses[1].q.w, unit.w, 1e-7);
  EXPECT_EQ(poses[2].q, Quatf::identity());
  EXPECT_TRUE(std::signbit(poses[2].p.x));
}

TEST(ModelBuilder, FinalizeChecksEditedLists) {
  ModelBuilder builder;
  builder.add_particle({}, {}, 1.0f);
  builder.add_particle({}, {}, 1.0f);
  builder.particle_q[1].z = kNan;
  EXPECT_ERROR(builder.finalize(Device::cpu()), ErrorKind::Value,
               "particle_q[1]: expected finite numbers, got (0, 0, nan)");
  EXPECT_NO_THROW(builder.finalize(Device::cpu(), {.skip_validation = true}));
  builder.particle_q[1].z = 2.0f;
  builder.particle_mass[0] = -1.0f;
  EXPECT_ERROR(builder.finalize(Device::cpu()), ErrorKind::Value, "particle_mass[0]");
  builder.particle_mass[0] = 1.0f;
  builder.particle_world[1] = 1;
  EXPECT_ERROR(builder.finalize(Device::cpu()), ErrorKind::Value, "particle_world[1]");
  builder.particle_world[1] = 0;
  builder.gravity.y = kInf;
  EXPECT_ERROR(builder.finalize(Device::cpu()), ErrorKind::Value, "gravity");
  builder.gravity.y = 0.0f;
  builder.particle_qd.pop_back();
  EXPECT_ERROR(builder.finalize(Device::cpu()), ErrorKind::Value,
               "particle_qd: expected 2 elements");
  EXPECT_ERROR(builder.finalize(Device::cpu(), {.skip_validation = true}), ErrorKind::Value,
               "particle_qd");
}

TEST(ModelBuilder, CanFinalizeAgainAndEmpty) {
  ModelBuilder builder;
  const auto empty = builder.finalize(Device::cpu());
  EXPECT_EQ(empty->particle_count(), 0);
  EXPECT_EQ(empty->state().particle_q.rows(), 0u);
  builder.add_particle({1.0f, 0.0f, 0.0f}, {}, 1.0f);
  const auto a = builder.finalize(Device::cpu()), b = builder.finalize(Device::cpu());
  EXPECT_NE(a->id(), b->id());
  EXPECT_EQ(a->particle_q.to_host(), b->particle_q.to_host());
  a->particle_q.fill({});
  EXPECT_EQ(b->particle_q.to_host()[0].x, 1.0f);
}

TEST(Model, CopiesHaveTheirOwnArraysAndId) {
  ModelBuilder builder;
  builder.add_particle({1.0f, 0.0f, 0.0f}, {}, 1.0f);
  builder.add_ground_plane();
  const auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 5.0f;
  const auto copy = model->clone();
  EXPECT_NE(copy->id(), model->id());
  EXPECT_EQ(copy->soft_contact_ke, 5.0f);
  EXPECT_EQ(copy->shape_label, model->shape_label);
  EXPECT_EQ(copy->counts(), model->counts());
  copy->particle_q.fill({});
  EXPECT_EQ(model->particle_q.to_host()[0].x, 1.0f);
}

TEST(Model, GravityCanBeSet) {
  const auto model = ModelBuilder().finalize(Device::cpu());
  model->set_gravity({1.0f, 2.0f, 3.0f});
  EXPECT_EQ(model->gravity.to_host()[0], (Vec3f{1.0f, 2.0f, 3.0f}));
  model->set_gravity({4.0f, 5.0f, 6.0f}, 0);
  EXPECT_EQ(model->gravity.to_host()[0], (Vec3f{4.0f, 5.0f, 6.0f}));
  EXPECT_ERROR(model->set_gravity({}, 1), ErrorKind::Index, "world: expected 0 to 0, got 1");
  EXPECT_ERROR(model->set_gravity({}, -1), ErrorKind::Index, "world");
  EXPECT_ERROR(model->set_gravity({kNan, 0.0f, 0.0f}), ErrorKind::Value, "expected finite");
}

// Newton 1.8.0: two static shapes and two shapes on one body give [[0, 2], [0, 3], [1, 2], [1, 3]].
TEST(ShapeContactPairs, LeaveOutStaticAndSameBodyPairs) {
  const std::vector<int32_t> body = {-1, -1, 0, 0}, flags(4, 7), group(4, 1), world(4, -1);
  EXPECT_EQ(make_shape_contact_pairs(body, flags, group, world, {}),
            (std::vector<Vec2i>{{0, 2}, {0, 3}, {1, 2}, {1, 3}}));
  EXPECT_EQ(make_shape_contact_pairs(body, flags, group, world, {{0, 3}, {1, 2}}),
            (std::vector<Vec2i>{{0, 2}, {1, 3}}));
  EXPECT_TRUE(
      make_shape_contact_pairs(std::vector<int32_t>(4, -1), flags, group, world, {}).empty());
}

// The search treats worlds one by one. Its pairs are those of a search over all pairs, in the same
// order.
TEST(ShapeContactPairs, OfManyWorldsAreThoseOfASearchOfAllByAll) {
  std::mt19937 random(3);
  const auto draw = [&](int32_t least, int32_t most) {
    return std::uniform_int_distribution<int32_t>(least, most)(random);
  };
  std::vector<int32_t> body, flags, group, world;
  std::set<std::pair<int32_t, int32_t>> filtered;
  for (int32_t s = 0; s < 120; ++s) {
    body.push_back(draw(-1, 40));
    flags.push_back(draw(0, 3) == 0 ? 5 : 7);
    group.push_back(draw(-2, 2));
    world.push_back(draw(-1, 4));
    if (s > 0) filtered.insert({draw(0, s - 1), s});
  }
  const ShapePairRules rules{body, flags, group, world, &filtered};
  std::vector<Vec2i> expected;
  for (int32_t i = 0; i < 120; ++i)
    for (int32_t j = i + 1; j < 120; ++j)
      if (may_touch(rules, i, j)) expected.push_back({i, j});
  EXPECT_GT(expected.size(), 100u);
  EXPECT_EQ(make_shape_contact_pairs(body, flags, group, world, filtered), expected);
}

TEST(ShapeContactPairs, FollowFlagsWorldsAndGroups) {
  const std::vector<int32_t> body = {0, 1, 2, 3};
  const std::vector<int32_t> all(4, 7), any(4, -1), one(4, 1);
  EXPECT_EQ(make_shape_contact_pairs(body, std::vector<int32_t>{7, 5, 7, 2}, one, any, {}),
            (std::vector<Vec2i>{{0, 2}, {0, 3}, {2, 3}}));
  EXPECT_EQ(make_shape_contact_pairs(body, all, one, std::vector<int32_t>{0, 1, -1, 0}, {}),
            (std::vector<Vec2i>{{0, 2}, {0, 3}, {1, 2}, {2, 3}}));
  // 1 meets 1 and -1; -1 meets everything but -1 and 0; 0 meets nothing; 1 and 2 do not meet.
  EXPECT_EQ(make_shape_contact_pairs(body, all, std::vector<int32_t>{1, 1, -1, 0}, any, {}),
            (std::vector<Vec2i>{{0, 1}, {0, 2}, {1, 2}}));
  EXPECT_EQ(make_shape_contact_pairs(body, all, std::vector<int32_t>{-1, -1, -2, 2}, any, {}),
            (std::vector<Vec2i>{{0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}}));
}

TEST(ShapeCollisionFilter, ChecksItsShapes) {
  ModelBuilder builder;
  builder.add_shape_box(-1);
  builder.add_shape_box(-1);
  builder.add_shape_collision_filter_pair(1, 0);
  EXPECT_ERROR(builder.add_shape_collision_filter_pair(0, 2), ErrorKind::Index,
               "expected shapes from 0 to 1, got 2");
  EXPECT_ERROR(builder.add_shape_collision_filter_pair(1, 1), ErrorKind::Value,
               "two different shapes");
  EXPECT_EQ(builder.finalize(Device::cpu())->shape_collision_filter_pairs,
            (std::set<std::pair<int32_t, int32_t>>{{0, 1}}));
}

}  // namespace
}  // namespace novaphy
