// Convex hulls: exact for known bodies, deterministic and limited in size. Point sets without a
// hull give clear errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>

#include "novaphy/core/error.h"
#include "novaphy/core/geometry/convex_hull.h"
#include "novaphy/core/geometry/hull_of_all.h"
#include "novaphy/core/geometry/mesh_mass.h"

namespace novaphy {
namespace {

std::vector<Vec3f> cube(float h) {
  std::vector<Vec3f> corners;
  for (int i = 0; i < 8; ++i) corners.push_back({i & 1 ? h : -h, i & 2 ? h : -h, i & 4 ? h : -h});
  return corners;
}
std::vector<Vec3f> cloud(int count, uint32_t seed, Vec3f axes = {1, 1, 1}) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  std::vector<Vec3f> points;
  for (int i = 0; i < count; ++i) {
    const Vec3f d = math::normalize(Vec3f{normal(random), normal(random), normal(random)});
    points.push_back({axes.x * d.x, axes.y * d.y, axes.z * d.z});
  }
  return points;
}
size_t face_count(const ConvexHull& hull) { return hull.face_normals.size(); }
// Returns the largest distance of p above the planes of the hull.
float height_above(const ConvexHull& hull, const Vec3f& p) {
  float height = -std::numeric_limits<float>::infinity();
  for (size_t f = 0; f < face_count(hull); ++f) {
    const Vec3f on_face = hull.vertices[size_t(hull.face_vertices[size_t(hull.face_starts[f])])];
    height = std::max(height, math::dot(hull.face_normals[f], p - on_face));
  }
  return height;
}
std::string error_of(const std::vector<Vec3f>& points, int32_t max_vertices = kMaxHullVertices) {
  try {
    convex_hull(points, max_vertices);
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::Value);
    return e.what();
  }
  return "no error";
}
#define EXPECT_HAS(text, part) EXPECT_NE((text).find(part), std::string::npos) << (text)

TEST(ConvexHull, OfACubeHasSixSquares) {
  const ConvexHull hull = convex_hull(cube(0.5f));
  ASSERT_EQ(hull.vertices.size(), 8u);
  ASSERT_EQ(face_count(hull), 6u);
  for (size_t f = 0; f < 6; ++f) {
    EXPECT_EQ(hull.face_starts[f + 1] - hull.face_starts[f], 4);
    const Vec3f n = hull.face_normals[f];
    EXPECT_EQ(std::abs(n.x) + std::abs(n.y) + std::abs(n.z), 1.0f);
  }
  EXPECT_NEAR(mesh_properties(hull.vertices, hull_triangles(hull)).volume, 1.0, 1e-12);
}

TEST(ConvexHull, LeavesOutDuplicatesAndPointsWithinFacesAndEdges) {
  std::vector<Vec3f> points = cube(1.0f);
  for (const Vec3f p : cube(1.0f)) points.push_back(p);
  for (const Vec3f p : cube(0.3f)) points.push_back(p);
  points.push_back({1, 0, 0});
  points.push_back({0.5f, 1, 1});
  std::reverse(points.begin(), points.end());
  const ConvexHull hull = convex_hull(points);
  EXPECT_EQ(hull.vertices.size(), 8u);
  EXPECT_EQ(face_count(hull), 6u);
}

TEST(ConvexHull, HoldsAllPointsAndIsAClosedPolytope) {
  for (const int count : {4, 5, 12, 40, 60}) {
    const std::vector<Vec3f> points = cloud(count, uint32_t(count), {1, 0.3f, 2});
    const ConvexHull hull = convex_hull(points);
    for (const Vec3f& p : points) EXPECT_LT(height_above(hull, p), 5e-3f);  // faces merged
    EXPECT_GT(mesh_properties(hull.vertices, hull_triangles(hull)).volume, 0.0);
    for (size_t i = 0; i < hull.vertices.size(); ++i) {
      EXPECT_EQ(hull.vertices[i], points[size_t(hull.input_index[i])]);
      const int32_t begin = hull.neighbor_starts[i], end = hull.neighbor_starts[i + 1];
      EXPECT_GE(end - begin, 3);
      for (int32_t k = begin; k < end; ++k) {
        const auto j = size_t(hull.neighbors[size_t(k)]);
        const auto first = hull.neighbors.begin() + hull.neighbor_starts[j];
        const auto last = hull.neighbors.begin() + hull.neighbor_starts[j + 1];
        EXPECT_TRUE(std::binary_search(first, last, int32_t(i)));
      }
    }
  }
}

TEST(ConvexHull, OfManyPointsStopsAtTheCapAndStaysNearTheirHull) {
  const std::vector<Vec3f> points = cloud(100000, 4);
  const ConvexHull hull = convex_hull(points);
  EXPECT_EQ(hull.vertices.size(), size_t(kMaxHullVertices));
  for (const Vec3f& p : points) ASSERT_LT(height_above(hull, p), 0.12f);
  const double ball = 4.0 / 3.0 * 3.14159265358979;
  const double volume = mesh_properties(hull.vertices, hull_triangles(hull)).volume;
  EXPECT_GT(volume, 0.85 * ball);
  EXPECT_LT(volume, ball);
  EXPECT_LE(convex_hull(points, 10).vertices.size(), 10u);
}

TEST(ConvexHull, IsTheSameEveryTimeAndAtEveryScale) {
  const std::vector<Vec3f> points = cloud(300, 5, {1, 2, 0.5f});
  const ConvexHull hull = convex_hull(points), again = convex_hull(points);
  EXPECT_EQ(hull.vertices, again.vertices);
  EXPECT_EQ(hull.face_normals, again.face_normals);
  EXPECT_EQ(hull.face_vertices, again.face_vertices);
  EXPECT_EQ(hull.neighbors, again.neighbors);
  for (const float scale : {0x1p-20f, 0x1p20f}) {
    std::vector<Vec3f> scaled;
    for (const Vec3f& p : points) scaled.push_back(p * scale);
    EXPECT_EQ(convex_hull(scaled).face_vertices, hull.face_vertices) << scale;
  }
}

TEST(ConvexHull, MergesFacesWithinATenthOfADegree) {
  std::vector<Vec3f> points = cube(1.0f);
  points.push_back({0, 0, 1.0005f});  // 0.03 degrees
  EXPECT_EQ(face_count(convex_hull(points)), 6u);
  points.back().z = 1.01f;  // 0.6 degrees
  EXPECT_EQ(face_count(convex_hull(points)), 9u);
}

// Its faces lie within 0.1 degrees of each other; the hull of its corners is no thinner.
TEST(ConvexHull, OfAThinTetrahedronKeepsItsCorners) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-0.4f, 0.4f);
  for (int k = 0; k < 2000; ++k) {
    std::vector<Vec3f> points;
    for (int i = 0; i < 4 + k % 5; ++i)
      points.push_back({uniform(random), 1e-3f * uniform(random), uniform(random)});
    const ConvexHull hull = convex_hull(points);
    EXPECT_NO_THROW(convex_hull(hull.vertices)) << k;  // the pipeline does the same
    for (const Vec3f& p : points) ASSERT_LT(height_above(hull, p), 7e-4f) << k;  // faces merged
  }
}

TEST(ConvexHull, OfAllPointsAsTrianglesHasTheirVolume) {
  const std::vector<Vec3f> points = cloud(20000, 6);
  const std::vector<int32_t> triangles = hull_of_all(points);
  EXPECT_GT(triangles.size(), size_t(3 * (2 * 19900 - 4)));  // all but points in a face
  const double volume = mesh_properties(points, triangles).volume;
  EXPECT_NEAR(volume, 4.0 / 3.0 * 3.14159265358979, 4e-3);
}

TEST(ConvexHull, RefusesWhatSpansNoVolume) {
  EXPECT_HAS(error_of({}), "expected at least 4, got 0");
  EXPECT_HAS(error_of({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}), "expected at least 4, got 3");
  EXPECT_HAS(error_of(std::vector<Vec3f>(7, {1, 2, 3})), "in one place");
  EXPECT_HAS(error_of({{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {3, 3, 3}}), "on one line");
  EXPECT_HAS(error_of({{0, 0, 5}, {1, 0, 5}, {0, 1, 5}, {1, 1, 5}}), "in one plane");
  EXPECT_HAS(error_of({{0, 0, 0}, {1, 0, 0}, {0, NAN, 0}, {0, 0, 1}}), "points[2]");
  EXPECT_HAS(error_of({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, INFINITY}}), "points[3]");
  EXPECT_HAS(error_of(cube(1.0f), 65), "max_vertices");
  EXPECT_HAS(error_of(cube(1.0f), 3), "max_vertices");
}

}  // namespace
}  // namespace novaphy
