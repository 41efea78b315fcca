// Volume, center and inertia of meshes, against closed forms.
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/geometry/mesh_mass.h"

namespace novaphy {
namespace {

struct Triangles {
  std::vector<Vec3f> vertices;
  std::vector<int32_t> indices;
};
// A box between lo and hi.
Triangles box(Vec3f lo, Vec3f hi) {
  Triangles t;
  for (int i = 0; i < 8; ++i)
    t.vertices.push_back({i & 1 ? hi.x : lo.x, i & 2 ? hi.y : lo.y, i & 4 ? hi.z : lo.z});
  t.indices = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
               2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
  return t;
}
std::string error_of(const Triangles& t) {
  try {
    mesh_properties(t.vertices, t.indices);
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::Value);
    return e.what();
  }
  return "no error";
}
#define EXPECT_HAS(text, part) EXPECT_NE((text).find(part), std::string::npos) << (text)

TEST(MeshMass, OfABoxIsTheClosedForm) {
  const Triangles t = box({-1, -0.5f, 0}, {1, 1.5f, 0.25f});
  const SolidProperties p = mesh_properties(t.vertices, t.indices);
  EXPECT_NEAR(p.volume, 1.0, 1e-14);
  EXPECT_NEAR(p.com.x, 0.0, 1e-14);
  EXPECT_NEAR(p.com.y, 0.5, 1e-14);
  EXPECT_NEAR(p.com.z, 0.125, 1e-14);
  EXPECT_NEAR(p.inertia.m[0][0], (4.0 + 0.0625) / 12, 1e-14);
  EXPECT_NEAR(p.inertia.m[1][1], (4.0 + 0.0625) / 12, 1e-14);
  EXPECT_NEAR(p.inertia.m[2][2], (4.0 + 4.0) / 12, 1e-14);
  EXPECT_NEAR(p.inertia.m[0][1], 0.0, 1e-14);
}

// A tetrahedron has products of inertia: 1/60 - 1/96 of x y about the center, for the unit one.
TEST(MeshMass, OfATetrahedronHasProductsOfInertia) {
  const SolidProperties p =
      mesh_properties(std::vector<Vec3f>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                      std::vector<int32_t>{0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3});
  EXPECT_NEAR(p.volume, 1.0 / 6, 1e-15);
  EXPECT_NEAR(p.com.z, 0.25, 1e-15);
  EXPECT_NEAR(p.inertia.m[0][0], 2 * (1.0 / 60 - 1.0 / 96), 1e-15);
  EXPECT_NEAR(p.inertia.m[0][1], -(1.0 / 120 - 1.0 / 96), 1e-15);
}

TEST(MeshMass, LosesNothingFarFromTheOrigin) {
  const Triangles t = box({1024, -2048, 512}, {1024.25f, -2047.5f, 512.5f});
  const SolidProperties p = mesh_properties(t.vertices, t.indices);
  EXPECT_NEAR(p.volume, 0.0625, 1e-15);
  EXPECT_NEAR(p.com.x, 1024.125, 1e-12);
  EXPECT_NEAR(p.inertia.m[0][0], 0.0625 * 0.5 / 12, 1e-15);
}

TEST(MeshMass, SubtractsCavities) {
  Triangles t = box({-1, -1, -1}, {1, 1, 1}), hole = box({-0.5f, -0.5f, -0.5f}, {0.5f, 0.5f, 0.5f});
  for (size_t k = 0; k < hole.indices.size(); k += 3)
    t.indices.insert(t.indices.end(),
                     {hole.indices[k] + 8, hole.indices[k + 2] + 8, hole.indices[k + 1] + 8});
  t.vertices.insert(t.vertices.end(), hole.vertices.begin(), hole.vertices.end());
  EXPECT_NEAR(mesh_properties(t.vertices, t.indices).volume, 7.0, 1e-13);
}

TEST(MeshMass, RefusesMeshesThatEncloseNothing) {
  const Triangles good = box({0, 0, 0}, {1, 1, 1});
  Triangles t = good;
  t.indices.resize(t.indices.size() - 3);
  EXPECT_HAS(error_of(t), "expected a closed mesh");
  t = good;
  std::swap(t.indices[0], t.indices[1]);
  EXPECT_HAS(error_of(t), "face outwards");
  t = good;
  for (size_t k = 0; k < t.indices.size(); k += 3) std::swap(t.indices[k], t.indices[k + 1]);
  EXPECT_HAS(error_of(t), "inside out");
  t = box({0, 0, 0}, {1, 1, 0});
  EXPECT_HAS(error_of(t), "encloses a volume");
}

TEST(MeshMass, RefusesBadNumbers) {
  Triangles t = box({0, 0, 0}, {1, 1, 1});
  t.indices[5] = 8;
  EXPECT_HAS(error_of(t), "indices[5]: expected 0 to 8 (exclusive), got 8");
  t.indices[5] = -1;
  EXPECT_HAS(error_of(t), "got -1");
  t = box({0, 0, 0}, {1, 1, 1});
  t.vertices[3].y = NAN;
  EXPECT_HAS(error_of(t), "vertices[3]");
  t.indices.pop_back();
  EXPECT_HAS(error_of(t), "3 per triangle");
  t.indices.clear();
  EXPECT_HAS(error_of(t), "3 per triangle, got 0");
}

}  // namespace
}  // namespace novaphy
