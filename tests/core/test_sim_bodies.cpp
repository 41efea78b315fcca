// Rigid bodies in ModelBuilder and Model: mass from shapes, worlds, bad input.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <thread>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kPi = std::numbers::pi;

Mat33f diagonal(float x, float y, float z) {
  return {{{x, 0.0f, 0.0f}, {0.0f, y, 0.0f}, {0.0f, 0.0f, z}}};
}

struct Mass {
  double mass = 0.0;
  Vec3<double> com{};
  double inertia[3][3] = {};
};

// Returns the mass, center of mass and inertia of the points where inside(point) holds, by midpoint
// sums over a box.
template <class Inside>
Mass integrate(const Vec3f& lower, const Vec3f& upper, double density, int n, Inside&& inside) {
  Mass sum;
  const double size[3] = {upper.x - lower.x, upper.y - lower.y, upper.z - lower.z};
  const double cell = density * size[0] * size[1] * size[2] / n / n / n;
  double second[3][3] = {}, first[3] = {};
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j)
      for (int k = 0; k < n; ++k) {
        const double p[3] = {lower.x + size[0] * (i + 0.5) / n, lower.y + size[1] * (j + 0.5) / n,
                             lower.z + size[2] * (k + 0.5) / n};
        if (!inside(p)) continue;
        sum.mass += cell;
        for (int a = 0; a < 3; ++a) {
          first[a] += cell * p[a];
          for (int b = 0; b < 3; ++b) second[a][b] += cell * p[a] * p[b];
        }
      }
  sum.com = {first[0] / sum.mass, first[1] / sum.mass, first[2] / sum.mass};
  const double c[3] = {sum.com.x, sum.com.y, sum.com.z};
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) second[a][b] -= sum.mass * c[a] * c[b];
  const double trace = second[0][0] + second[1][1] + second[2][2];
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) sum.inertia[a][b] = (a == b ? trace : 0.0) - second[a][b];
  return sum;
}

void expect_mass(const Model& model, const Mass& expected, double tolerance) {
  const float mass = model.body_mass.to_host()[0];
  const Vec3f com = model.body_com.to_host()[0];
  const Mat33f inertia = model.body_inertia.to_host()[0];
  EXPECT_NEAR(mass, expected.mass, tolerance * expected.mass);
  double largest = 0.0;
  for (const auto& row : expected.inertia)
    for (const double i : row) largest = std::max(largest, std::abs(i));
  const double length = std::sqrt(largest / expected.mass);
  EXPECT_NEAR(com.x, expected.com.x, tolerance * length);
  EXPECT_NEAR(com.y, expected.com.y, tolerance * length);
  EXPECT_NEAR(com.z, expected.com.z, tolerance * length);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      EXPECT_NEAR(inertia.m[i][j], expected.inertia[i][j], tolerance * largest) << i << j;
}

TEST(Bodies, TheModelHoldsWhatWasAdded) {
  ModelBuilder builder;
  const Transformf pose = {{1.0f, 2.0f, 3.0f}, {0.0f, 0.0f, 0.6f, 0.8f}};
  EXPECT_EQ(builder.add_body({.xform = pose,
                              .com = {0.1f, 0.0f, 0.0f},
                              .mass = 2.0f,
                              .inertia = diagonal(0.5f, 0.25f, 0.4f),
                              .label = "die"}),
            0);
  EXPECT_EQ(builder.add_body({.is_kinematic = true}), 1);
  EXPECT_EQ(builder.add_shape_box(0, {.cfg = ShapeConfig{.density = 0.0f}}), 0);
  builder.body_qd[0].angular = {1.0f, 5.0f, 2.0f};
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->body_count(), 2);
  EXPECT_EQ(model->body_label, (std::vector<std::string>{"die", "body_1"}));
  EXPECT_EQ(model->body_q.to_host(), (std::vector<Transformf>{pose, Transformf::identity()}));
  EXPECT_EQ(model->body_mass.to_host(), (std::vector<float>{2.0f, 0.0f}));
  EXPECT_EQ(model->body_inv_mass.to_host(), (std::vector<float>{0.5f, 0.0f}));
  EXPECT_EQ(model->body_com.to_host()[0], (Vec3f{0.1f, 0.0f, 0.0f}));
  EXPECT_EQ(model->body_inertia.to_host(),
            (std::vector<Mat33f>{diagonal(0.5f, 0.25f, 0.4f), Mat33f{}}));
  EXPECT_EQ(model->body_inv_inertia.to_host(),
            (std::vector<Mat33f>{diagonal(2.0f, 4.0f, 2.5f), Mat33f{}}));
  EXPECT_EQ(model->body_flags.to_host(), (std::vector<int32_t>{1, 2}));
  EXPECT_EQ(model->body_world.to_host(), (std::vector<int32_t>{-1, -1}));
  EXPECT_EQ(model->shape_body.to_host(), (std::vector<int32_t>{0}));
  const SimState state = model->state();
  EXPECT_EQ(state.body_q.to_host()[0], pose);
  EXPECT_EQ(state.body_qd.to_host()[0], (SpatialVectorf{{}, {1.0f, 5.0f, 2.0f}}));
}

TEST(Bodies, ABoxOnABaseMassHasTheMassOfTheDie) {
  ModelBuilder builder;
  builder.add_body({.mass = 4.0f});
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_FLOAT_EQ(model->body_mass.to_host()[0], 12.0f);
  EXPECT_FLOAT_EQ(model->body_inertia.to_host()[0].m[0][0], 0.16f / 3.0f);
}

TEST(Bodies, EveryShapeHasTheMassOfItsIntegral) {
  const auto check = [](GeoType type, const Vec3f& scale, const Vec3f& half, auto&& inside) {
    ModelBuilder builder;
    builder.add_body();
    builder.add_shape(
        {.body = 0, .type = type, .scale = scale, .cfg = ShapeConfig{.density = 700}});
    SCOPED_TRACE(geo_type_name(type));
    expect_mass(*builder.finalize(Device::cpu()), integrate(-half, half, 700.0, 160, inside), 4e-3);
  };
  const float r = 0.4f, h = 0.7f;
  const auto radius2 = [](const double* p) { return p[0] * p[0] + p[1] * p[1]; };
  check(GeoType::SPHERE, {r, 0.0f, 0.0f}, {r, r, r},
        [&](const double* p) { return radius2(p) + p[2] * p[2] < r * r; });
  check(GeoType::BOX, {0.2f, 0.3f, 0.5f}, {0.2f, 0.3f, 0.5f}, [](const double*) { return true; });
  check(GeoType::ELLIPSOID, {0.2f, 0.3f, 0.5f}, {0.2f, 0.3f, 0.5f}, [](const double* p) {
    return p[0] * p[0] / 0.04 + p[1] * p[1] / 0.09 + p[2] * p[2] / 0.25 < 1.0;
  });
  check(GeoType::CYLINDER, {r, h, 0.0f}, {r, r, h},
        [&](const double* p) { return radius2(p) < r * r; });
  check(GeoType::CAPSULE, {r, h, 0.0f}, {r, r, h + r}, [&](const double* p) {
    const double beyond = std::max(std::abs(p[2]) - h, 0.0);
    return radius2(p) + beyond * beyond < r * r;
  });
  check(GeoType::CONE, {r, h, 0.0f}, {r, r, h}, [&](const double* p) {
    const double at = r * (h - p[2]) / (2.0 * h);
    return radius2(p) < at * at;
  });
}

TEST(Bodies, ATurnedConeAndABaseMassCombine) {
  ModelBuilder builder;
  const Vec3f at = {0.3f, -0.2f, 0.5f};
  const Quatf q = {0.48f, -0.36f, 0.64f, 0.48f};  // unit length
  builder.add_body({.com = {-0.1f, 0.2f, 0.0f}, .mass = 3.0f});
  builder.add_shape_cone(0, {.xform = {at, q}, .radius = 0.4f, .half_height = 0.6f});
  const Vec3f half = {0.9f, 0.9f, 0.9f};
  Mass cone = integrate(at - half, at + half, 1000.0, 200, [&](const double* p) {
    const Vec3f local = math::rotate_inverse(
        q, Vec3f{static_cast<float>(p[0]) - at.x, static_cast<float>(p[1]) - at.y,
                 static_cast<float>(p[2]) - at.z});
    const float radius = 0.4f * (0.6f - local.z) / 1.2f;
    return std::abs(local.z) < 0.6f && local.x * local.x + local.y * local.y < radius * radius;
  });
  Mass both;
  both.mass = cone.mass + 3.0;
  both.com = {(cone.com.x * cone.mass - 0.3) / both.mass,
              (cone.com.y * cone.mass + 0.6) / both.mass, cone.com.z * cone.mass / both.mass};
  const auto add = [&](double m, const Vec3<double>& c) {
    const double d[3] = {c.x - both.com.x, c.y - both.com.y, c.z - both.com.z};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        both.inertia[i][j] +=
            m * ((i == j ? d[0] * d[0] + d[1] * d[1] + d[2] * d[2] : 0.0) - d[i] * d[j]);
  };
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) both.inertia[i][j] = cone.inertia[i][j];
  add(cone.mass, cone.com);
  add(3.0, {-0.1, 0.2, 0.0});
  expect_mass(*builder.finalize(Device::cpu()), both, 4e-3);
}

TEST(Bodies, AShellIsWhatItsWallWeighs) {
  ModelBuilder builder;
  builder.add_body();
  const ShapeConfig shell = {.density = 700.0f, .margin = 0.01f, .is_solid = false};
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.2f, .hz = 0.3f, .cfg = shell});
  const double outer = 8 * 0.1 * 0.2 * 0.3, inner = 8 * 0.09 * 0.19 * 0.29;
  EXPECT_NEAR(builder.finalize(Device::cpu())->body_mass.to_host()[0], 700 * (outer - inner), 1e-5);

  ModelBuilder cone;
  cone.add_body();
  cone.add_shape_cone(0, {.radius = 0.4f, .half_height = 0.6f, .cfg = shell});
  const auto model = cone.finalize(Device::cpu());
  // Disks along the axis: the wall is 0.01 m thick at right angles to both surfaces.
  const double lateral = 0.01 * std::hypot(0.4, 1.2) / 1.2;  // along the radius
  double mass = 0.0, moment = 0.0, about_axis = 0.0;
  for (int k = 0; k < 120'000; ++k) {
    const double above = (k + 0.5) * 1e-5, outside = 0.4 * (1.0 - above / 1.2);
    const double inside = above > 0.01 ? std::max(outside - lateral, 0.0) : 0.0;
    const double disk = 700 * kPi * 1e-5 * (outside * outside - inside * inside);
    mass += disk;
    moment += disk * (above - 0.6);
    about_axis += 0.5 * disk * (outside * outside + inside * inside);
  }
  EXPECT_NEAR(model->body_mass.to_host()[0], mass, 1e-4 * mass);
  EXPECT_NEAR(model->body_com.to_host()[0].z, moment / mass, 1e-5);
  EXPECT_NEAR(model->body_inertia.to_host()[0].m[2][2], about_axis, 1e-4 * about_axis);

  EXPECT_ERROR(builder.add_shape_sphere(0, {.radius = 0.01f, .cfg = shell}), ErrorKind::Value,
               "add_shape_sphere: cfg.margin");
  EXPECT_ERROR(builder.add_shape_sphere(0, {.cfg = ShapeConfig{.is_solid = false}}),
               ErrorKind::Value, "cfg.margin");
}

TEST(Bodies, LockedInertiaIgnoresShapes) {
  ModelBuilder builder;
  builder.add_body({.mass = 1.0f, .inertia = diagonal(1.0f, 1.0f, 1.0f), .lock_inertia = true});
  builder.add_shape_box(0, {.xform = {{1.0f, 0.0f, 0.0f}, Quatf::identity()}});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->body_mass.to_host()[0], 1.0f);
  EXPECT_EQ(model->body_com.to_host()[0], Vec3f{});
}

TEST(Bodies, TheInverseInertiaFollowsAndIsTheInverse) {
  ModelBuilder builder;
  builder.add_body({.mass = 1.0f, .inertia = diagonal(1.0f, 1.0f, 1.0f)});
  const auto model = builder.finalize(Device::cpu());
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  for (int k = 0; k < 100; ++k) {
    float g[3][3];
    for (auto& row : g)
      for (float& x : row) x = uniform(random);
    Mat33f a;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        a.m[i][j] = i == j ? 0.3f : 0.0f;
        for (int l = 0; l < 3; ++l) a.m[i][j] += g[i][l] * g[j][l];
      }
    model->body_inertia.fill(a);
    model->update_derived();
    const Mat33f inverse = model->body_inv_inertia.to_host()[0];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        float product = 0.0f;
        for (int l = 0; l < 3; ++l) product += a.m[i][l] * inverse.m[l][j];
        EXPECT_NEAR(product, i == j ? 1.0f : 0.0f, 1e-5f);
        EXPECT_EQ(inverse.m[i][j], inverse.m[j][i]);
      }
  }
}

TEST(Bodies, PairsOfShapesAreListedWhenTheFirstOneAsks) {
  ModelBuilder builder;
  for (int32_t b = 0; b < 40; ++b) {
    builder.add_body();
    builder.add_shape_sphere(b);
  }
  builder.add_shape_collision_filter_pair(3, 5);
  const auto model = builder.finalize(Device::cpu());
  EXPECT_FALSE(model->shape_pair_list().is_made());
  // Later edits do not matter.
  model->shape_flags.fill(0);
  const auto copy = model->clone();
  EXPECT_FALSE(copy->shape_pair_list().is_made());
  std::vector<const void*> found(4);
  std::vector<std::thread> threads;
  for (const void*& of_thread : found)
    threads.emplace_back([&] { of_thread = model->shape_contact_pairs().data(); });
  for (std::thread& thread : threads) thread.join();
  for (const void* of_thread : found) EXPECT_EQ(of_thread, found[0]);
  std::vector<Vec2i> expected;
  for (int32_t i = 0; i < 40; ++i)
    for (int32_t j = i + 1; j < 40; ++j)
      if (i != 3 || j != 5) expected.push_back({i, j});
  EXPECT_EQ(model->shape_contact_pairs().to_host(), expected);
  EXPECT_EQ(copy->shape_contact_pair_count(), 779);
  // An edited list goes with its model.
  std::vector<Vec2i> edited = expected;
  edited[0] = {1, 2};
  DeviceArray<Vec2i> list = model->shape_contact_pairs();
  list.copy_from_host(std::span<const Vec2i>(edited));
  EXPECT_EQ(model->clone()->shape_contact_pairs().to_host(), edited);
}

TEST(Bodies, WorldsCarryTheirBodies) {
  ModelBuilder one;
  one.add_shape_box(-1);
  one.add_body({.xform = {{0.0f, 0.0f, 1.0f}, Quatf::identity()}});
  one.add_shape_sphere(0);
  one.body_qd[0] = {{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}};
  ModelBuilder builder;
  builder.add_world(one);
  const float s = std::sqrt(0.5f);
  builder.add_world(one, {{5.0f, 0.0f, 0.0f}, {0.0f, 0.0f, s, s}});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->body_world.to_host(), (std::vector<int32_t>{0, 1}));
  EXPECT_EQ(model->shape_body.to_host(), (std::vector<int32_t>{-1, 0, -1, 1}));
  EXPECT_EQ(model->shape_contact_pairs().to_host(), (std::vector<Vec2i>{{0, 1}, {2, 3}}));
  const Transformf pose = model->body_q.to_host()[1];
  EXPECT_NEAR(pose.p.x, 5.0f, 1e-6f);
  EXPECT_NEAR(pose.q.z, s, 1e-6f);
  const SpatialVectorf qd = model->body_qd.to_host()[1];
  EXPECT_NEAR(qd.linear.y, 1.0f, 1e-6f);
  EXPECT_NEAR(qd.angular.x, -1.0f, 1e-6f);
  // The copy that was not moved has the same bits.
  EXPECT_EQ(model->body_q.to_host()[0], one.body_q[0]);

  ModelBuilder many;
  many.replicate(one, 3, {2.0f, 0.0f, 0.0f});
  EXPECT_EQ(many.finalize(Device::cpu())->body_world.to_host(), (std::vector<int32_t>{0, 1, 2}));
}

TEST(Bodies, BadBodiesAreRefused) {
  ModelBuilder b;
  EXPECT_ERROR(b.add_body({.xform = {{kNan, 0.0f, 0.0f}, Quatf::identity()}}), ErrorKind::Value,
               "add_body: xform.p");
  EXPECT_ERROR(b.add_body({.xform = {{}, {0.0f, 0.0f, 0.0f, 1.1f}}}), ErrorKind::Value, "xform.q");
  EXPECT_ERROR(b.add_body({.mass = -1.0f}), ErrorKind::Value, "add_body: mass");
  EXPECT_ERROR(b.add_body({.mass = INFINITY}), ErrorKind::Value, "add_body: mass");
  EXPECT_ERROR(b.add_body({.com = {0.0f, kNan, 0.0f}}), ErrorKind::Value, "add_body: com");
  const auto inertia = [&](const Mat33f& i) { b.add_body({.mass = 1.0f, .inertia = i}); };
  EXPECT_ERROR(inertia(diagonal(1.0f, kNan, 1.0f)), ErrorKind::Value, "finite");
  EXPECT_ERROR(inertia(diagonal(-1.0f, 1.0f, 1.0f)), ErrorKind::Value, "positive definite");
  EXPECT_ERROR(inertia(diagonal(0.0f, 1.0f, 1.0f)), ErrorKind::Value, "positive definite");
  b.balance_inertia = false;
  EXPECT_ERROR(inertia(diagonal(1.0f, 0.1f, 0.1f)), ErrorKind::Value, "sum of the other two");
  Mat33f skew = diagonal(1.0f, 1.0f, 1.0f);
  skew.m[0][1] = 0.1f;
  EXPECT_ERROR(inertia(skew), ErrorKind::Value, "symmetric");
  EXPECT_NO_THROW(inertia(diagonal(1.0f, 0.4f, 0.6f))) << "a flat body";
  EXPECT_ERROR(b.add_body({.inertia = diagonal(1.0f, 1.0f, 1.0f)}), ErrorKind::Value, "mass");
  EXPECT_ERROR(b.add_shape_box(1), ErrorKind::Index, "add_shape_box: body");
  EXPECT_ERROR(b.add_shape_plane({.body = 0}), ErrorKind::Value, "add_shape_plane: body");
}

TEST(Bodies, FinalizeRefusesABodyThatCannotMove) {
  {
    ModelBuilder b;
    b.add_body();
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_mass[0]");
    b.add_shape_box(0, {.cfg = ShapeConfig{.density = 0.0f}});
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_mass[0]");
  }
  {
    ModelBuilder b;
    b.add_body({.mass = 1.0f});
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_inertia[0]");
  }
  {
    ModelBuilder b;
    b.add_body({.is_kinematic = true});
    b.body_q[0].q.w = kNan;
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_q[0].q");
    b.body_q[0] = Transformf::identity();
    b.body_qd[0].angular.x = kNan;
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_qd[0]");
    b.body_qd.clear();
    EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: body_qd");
  }
}

}  // namespace
}  // namespace novaphy
