// Convex shapes that are lowered into triangle meshes of all kinds. Each touching pose has a
// touching row, and no row is deeper than the shape was lowered. A float64 search finds the touch.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "collision/geometry_reference.h"
#include "novaphy/collision/geometry/mesh_mesh.h"
#include "novaphy/collision/mesh_tree.h"
#include "support/triangles.h"

namespace geometry_test {
namespace {

using novaphy::testing::Triangles;

// Convex, at most as far as the surface outside, and < 0 within.
double level(const geometry::Shape& s, const Vec3d& x) {
  const Vec3d h = widen(s.scale);
  const double rho = std::hypot(x.x, x.y);
  switch (s.type) {
    case GeoType::SPHERE:
      return norm(x) - h.x;
    case GeoType::CAPSULE:
      return std::hypot(rho, std::max(std::abs(x.z) - h.y, 0.0)) - h.x;
    case GeoType::CYLINDER:
      return std::max(rho - h.x, std::abs(x.z) - h.y);
    default:
      return std::max({std::abs(x.x) - h.x, std::abs(x.y) - h.y, std::abs(x.z) - h.z});
  }
}

template <class F>
double least_of(F f) {  // on [0, 1], where f is convex
  double at;
  return std::min({-golden(
                       0.0, 1.0, 24, [&](double x) { return -f(x); }, at),
                   f(0.0), f(1.0)});
}

struct Ground {
  MeshTree tree;
  explicit Ground(const Triangles& t) : tree(build_mesh_tree(t.vertices, t.indices)) {}

  // Returns the smallest level of the mesh near the shape, at most `most`.
  double depth(const Solid& b, double most) const {
    const Rigid r = rigid(b.pose);
    const Vec3d h = widen(b.shape.scale);
    const double bound = h.x + h.y + h.z;
    double best = most;
    for (const Vec3i& t : tree.triangles) {
      const auto in = [&](int32_t i) { return r.in(widen(tree.vertices[size_t(i)]) - r.p); };
      const Vec3d x = in(t.x), y = in(t.y), z = in(t.z), middle = (x + y + z) * (1.0 / 3.0);
      const double around = std::max({norm(x - middle), norm(y - middle), norm(z - middle)});
      if (norm(middle) - bound - around >= best || level(b.shape, middle) - around >= best)
        continue;
      best = std::min(best, least_of([&](double u) {
                        const Vec3d p = x + (y - x) * u, q = x + (z - x) * u;
                        return least_of([&](double v) { return level(b.shape, p + (q - p) * v); });
                      }));
    }
    return best;
  }
};

// Makes a ball whose edges are halved `level` times: 20, 80, 320, ... triangles.
Triangles ball(int level, double radius) {
  const double g = 0.5 * (1 + std::sqrt(5.0));
  std::vector<Vec3d> v;
  for (const double a : {-1.0, 1.0})
    for (const double b : {-g, g}) v.insert(v.end(), {{a, b, 0}, {0, a, b}, {b, 0, a}});
  std::vector<Vec3i> faces;
  for (int i = 0; i < 12; ++i)
    for (int j = 0; j < 12; ++j)
      for (int k = 0; k < 12; ++k) {
        const Vec3d &a = v[size_t(i)], &b = v[size_t(j)], &c = v[size_t(k)];
        if (i < j && i < k && norm(a - b) < 2.1 && norm(b - c) < 2.1 && norm(c - a) < 2.1 &&
            math::dot(math::cross(b - a, c - a), a) > 0)
          faces.push_back({i, j, k});
      }
  for (int l = 0; l < level; ++l) {
    std::map<std::pair<int32_t, int32_t>, int32_t> middles;
    const auto middle = [&](int32_t i, int32_t j) {
      const auto [at, is_new] = middles.try_emplace(std::minmax(i, j), int32_t(v.size()));
      if (is_new) v.push_back(unit(v[size_t(i)]) + unit(v[size_t(j)]));
      return at->second;
    };
    std::vector<Vec3i> finer;
    for (const Vec3i& f : faces) {
      const int32_t x = middle(f.y, f.z), y = middle(f.z, f.x), z = middle(f.x, f.y);
      finer.insert(finer.end(), {{f.x, z, y}, {f.y, x, z}, {f.z, y, x}, {x, y, z}});
    }
    faces = finer;
  }
  Triangles t;
  for (const Vec3d& x : v) t.vertices.push_back(narrow(unit(x) * radius));
  for (const Vec3i& f : faces) t.indices.insert(t.indices.end(), {f.x, f.y, f.z});
  return t;
}

Triangles bumps(double cell, double sigma, uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  return novaphy::testing::terrain(16, float(cell),
                                   [&](float, float) { return float(sigma) * normal(random); });
}

geometry::Shape shape(int kind, float r) {
  switch (kind) {
    case 0:
      return {GeoType::SPHERE, {r, 0, 0}, {}};
    case 1:
      return {GeoType::BOX, {r, 1.3f * r, 0.8f * r}, {}};
    case 2:
      return {GeoType::CAPSULE, {r, 3.0f * r, 0}, {}};
    case 3:
      return {GeoType::CYLINDER, {r, 1.2f * r, 0}, {}};
    default:
      return {GeoType::BOX, {10.0f * r, 0.5f * r, 0.5f * r}, {}};
  }
}

struct Poses {
  int count = 0, missing = 0, too_deep = 0;

  // Moves B along d until the meshes touch, then by another 1 to 30 % of B's radius.
  void lower(const Ground& ground, Solid b, Vec3d from, const Vec3d& d, double share, float r) {
    double gap = 0.2;
    for (int i = 0; i < 60 && gap > 1e-5; ++i) {
      b.pose.p = narrow(from);
      gap = ground.depth(b, 0.2);
      from = from + d * gap;
    }
    if (gap > 1e-5) return;  // passes by
    const double depth = share * double(r);
    b.pose.p = narrow(from + d * depth);
    if (ground.depth(b, 0.2) > -1e-5) return;
    std::vector<geometry::MeshContact> c;
    geometry::collide_mesh(mesh_view(ground.tree), b.shape, b.pose, 0.02f,
                           [&](const geometry::MeshContact& contact) { c.push_back(contact); });
    c.resize(size_t(
        geometry::reduce_mesh_contacts(mesh_view(ground.tree), c.data(), int32_t(c.size()))));
    double deepest = 1.0;
    for (const auto& contact : c) deepest = std::min(deepest, double(contact.point.distance));
    ++count;
    missing += !(deepest <= 0.0);
    too_deep += -deepest > 1.5 * depth + 1e-4;
  }
};

constexpr int kPoses = 4;

TEST(MeshPoses, OnBumpsHaveARowThatTouches) {
  Scenes scenes(11);
  Poses poses;
  for (int kind = 0; kind < 5; ++kind)
    for (const double cell : {0.05, 0.1, 0.25, 0.5})
      for (const double sigma : {0.0, 0.003, 0.01, 0.03, 0.06}) {
        const Ground ground(bumps(cell, sigma, uint32_t(7 * kind) + uint32_t(1000 * sigma)));
        for (int k = 0; k < kPoses; ++k) {
          const auto r = float(scenes.uniform(0.05, 0.15));
          const Solid b{shape(kind, r), {{}, scenes.rotation()}, nullptr};
          const double to = 4.0 * cell;
          poses.lower(ground, b,
                      {scenes.uniform(-to, to), scenes.uniform(-to, to), 0.5 + 10.0 * double(r)},
                      {0, 0, -1}, scenes.uniform(0.01, 0.3), r);
        }
      }
  EXPECT_GT(poses.count, 350);
  EXPECT_EQ(poses.missing, 0) << poses.count;
  EXPECT_LE(poses.too_deep, 2) << poses.count;
}

TEST(MeshPoses, OnBallsOfTrianglesHaveARowThatTouches) {
  Scenes scenes(12);
  Poses poses;
  for (int level = 1; level < 5; ++level) {
    const Ground ground(ball(level, 0.4));
    for (int kind = 0; kind < 5; ++kind)
      for (int k = 0; k < 2 * kPoses; ++k) {
        const auto r =
            float(kind < 4 && k % 2 == 0 ? scenes.uniform(0.2, 0.4) : scenes.uniform(0.05, 0.15));
        const Solid b{shape(kind, r), {{}, scenes.rotation()}, nullptr};
        const Vec3d d = scenes.direction();
        poses.lower(ground, b, d * (-0.6 - 10.0 * double(r)) + scenes.direction() * 0.1, d,
                    scenes.uniform(0.01, 0.3), r);
      }
  }
  EXPECT_GT(poses.count, 140);
  EXPECT_EQ(poses.missing, 0) << poses.count;
  EXPECT_LE(poses.too_deep, 1) << poses.count;
}

// For a convex mesh: a point below all planes is inside.
struct Round {
  MeshTree tree;
  geometry::GeometryView view;
  explicit Round(const Triangles& t) : tree(build_mesh_tree(t.vertices, t.indices)) {
    view.mesh = mesh_view(tree);
    view.box = tree.nodes[0].box;
  }
  double level(const Vec3d& x) const {
    double most = -1e9;
    for (size_t t = 0; t < tree.triangles.size(); ++t)
      most = std::max(most, math::dot(widen(tree.normals[t]),
                                      x - widen(tree.vertices[size_t(tree.triangles[t].x)])));
    return most;
  }
  // The least level of the edges of B.
  double depth(const Round& b, const Transformf& pose) const {
    const Rigid r = rigid(pose);
    double best = 0.2;
    for (const Vec3i& t : b.tree.triangles) {
      const Vec3d x = r.point(widen(b.tree.vertices[size_t(t.x)])),
                  y = r.point(widen(b.tree.vertices[size_t(t.y)]));
      if (level((x + y) * 0.5) - 0.5 * norm(y - x) >= best) continue;
      best = std::min(best, least_of([&](double u) { return level(x + (y - x) * u); }));
    }
    return best;
  }
};

// Crossing edges between faces that are nearly one decide here.
TEST(MeshPoses, RoundMeshesHaveARowThatTouches) {
  Scenes scenes(13);
  const Round coarse(ball(1, 0.5)), fine(ball(2, 0.5)), small(ball(1, 0.1));
  const Round* pairs[][2] = {{&coarse, &fine}, {&fine, &fine}, {&coarse, &small}, {&small, &small}};
  int count = 0, missing = 0;
  for (const auto& [a, b] : pairs)
    for (int k = 0; k < 40; ++k) {
      Transformf pose{{}, scenes.rotation()};
      const Vec3d d = scenes.direction();
      Vec3d p = d * -1.3 + scenes.direction() * 0.05;
      // The search uses edges alone, so a corner of A may have touched earlier.
      double gap = 0.2;
      for (int i = 0; i < 60 && gap > 1e-5; ++i) {
        pose.p = narrow(p);
        gap = std::min(a->depth(*b, pose), b->depth(*a, math::inverse(pose)));
        p = p + d * gap;
      }
      if (gap > 1e-5) continue;
      pose.p = narrow(p + d * scenes.uniform(1e-4, 5e-3));
      double deepest = 1.0;
      geometry::collide_meshes(a->view.mesh, b->view.mesh, pose,
                               geometry::mesh_reach(a->view, b->view, 0.01f, 0.0f),
                               [&](const geometry::MeshContact& contact) {
                                 deepest = std::min(deepest, double(contact.point.distance));
                               });
      ++count;
      missing += !(deepest <= 0.0);
    }
  EXPECT_GT(count, 140);
  EXPECT_EQ(missing, 0) << count;
}

}  // namespace
}  // namespace geometry_test
