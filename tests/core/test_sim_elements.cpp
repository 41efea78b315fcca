// ModelBuilder's springs, triangles, bending edges, tetrahedra, grids and meshes.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

const std::vector<Vec3f> kCorners = {
    {0.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}};

ModelBuilder with_corners() {
  ModelBuilder builder;
  for (const Vec3f& x : kCorners) builder.add_particle(x, {}, 1.0f);
  return builder;
}
void expect_untouched(const ModelBuilder& builder, int32_t particles) {
  EXPECT_EQ(builder.particle_count(), particles);
  EXPECT_EQ(builder.particle_mass.size(), static_cast<size_t>(particles));
  EXPECT_EQ(builder.spring_count(), 0);
  EXPECT_EQ(builder.tri_count(), 0);
  EXPECT_EQ(builder.edge_count(), 0);
  EXPECT_EQ(builder.tet_count(), 0);
}

TEST(Elements, KeepWhatIsAddedAndMeasureTheRestShape) {
  ModelBuilder builder = with_corners();
  EXPECT_EQ(builder.add_spring(0, 3, 5.0f, 0.5f, 2.0f), 0);
  EXPECT_EQ(builder.add_triangle(0, 1, 2), 0.5f);
  EXPECT_EQ(builder.add_triangle(0, 2, 3, {1.0f, 2.0f, 3.0f, 4.0f, 5.0f}), 0.5f);
  EXPECT_EQ(builder.add_tetrahedron(0, 1, 2, 3, 7.0f, 8.0f, 9.0f), 1.0f / 6.0f);
  EXPECT_EQ(builder.add_edge(1, 3, 0, 2), 0);
  EXPECT_EQ(builder.add_edge(-1, 3, 0, 2, 0.25f, {6.0f, 0.5f}), 1);
  const auto model = builder.finalize(Device::cpu());
  const Model& m = *model;
  EXPECT_EQ(m.spring_count(), 1);
  EXPECT_EQ(m.particle_spring_indices.to_host(), (std::vector<Vec2i>{{0, 3}}));
  EXPECT_EQ(m.particle_spring_rest_length.to_host(), (std::vector<float>{1.0f}));
  EXPECT_EQ(m.particle_spring_stiffness.to_host(), (std::vector<float>{5.0f}));
  EXPECT_EQ(m.particle_spring_damping.to_host(), (std::vector<float>{0.5f}));
  EXPECT_EQ(m.particle_spring_control.to_host(), (std::vector<float>{2.0f}));
  EXPECT_EQ(m.particle_tri_indices.to_host(), (std::vector<Vec3i>{{0, 1, 2}, {0, 2, 3}}));
  EXPECT_EQ(m.particle_tri_area.to_host(), (std::vector<float>{0.5f, 0.5f}));
  EXPECT_EQ(m.particle_tri_pose.to_host()[0], (Mat22f{{{1.0f, 0.0f}, {0.0f, 1.0f}}}));
  EXPECT_EQ(m.particle_tri_material.to_host(),
            (std::vector<float>{100.0f, 100.0f, 10.0f, 0.0f, 0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f}));
  EXPECT_EQ(m.particle_tet_volume.to_host(), (std::vector<float>{1.0f / 6.0f}));
  EXPECT_EQ(m.particle_tet_material.to_host(), (std::vector<float>{7.0f, 8.0f, 9.0f}));
  EXPECT_EQ(m.particle_edge_rest_length.to_host(), (std::vector<float>{1.0f, 1.0f}));
  EXPECT_NEAR(std::fabs(m.particle_edge_rest_angle.to_host()[0]), std::acos(0.0f), 1e-6f);
  EXPECT_EQ(m.particle_edge_rest_angle.to_host()[1], 0.25f);
  EXPECT_EQ(m.particle_edge_material.to_host(), (std::vector<float>{100.0f, 0.0f, 6.0f, 0.5f}));
}

TEST(Elements, ActivationsOfAControlAreTheModels) {
  ModelBuilder builder = with_corners();
  builder.add_triangle(0, 1, 2);
  builder.add_tetrahedron(0, 1, 2, 3);
  const auto model = builder.finalize(Device::cpu());
  model->particle_tet_activation.fill(0.25f);
  model->particle_tri_activation.fill(-0.5f);
  const Control control = model->control();
  EXPECT_EQ(control.particle_tet_activation.to_host(), (std::vector<float>{0.25f}));
  EXPECT_EQ(control.particle_tri_activation.to_host(), (std::vector<float>{-0.5f}));
}

TEST(Elements, BadOnesAreRefusedByNameAndLeaveTheBuilderAsItWas) {
  ModelBuilder builder = with_corners();
  builder.add_particle({1.0f, 1.0f, 0.0f}, {}, 1.0f);
  builder.add_particle({2.0f, 0.0f, 1e-9f}, {}, 1.0f);
  // Degenerate, inverted, twice the same particle.
  EXPECT_ERROR(builder.add_triangle(0, 1, 5), ErrorKind::Value,
               "triangle 0 (particles 0, 1, 5): expected an area");
  EXPECT_ERROR(builder.add_triangle(0, 1, 1), ErrorKind::Value, "degenerate");
  EXPECT_ERROR(builder.add_tetrahedron(0, 1, 2, 4), ErrorKind::Value,
               "tetrahedron 0 (particles 0, 1, 2, 4): expected a volume");
  EXPECT_ERROR(builder.add_tetrahedron(0, 2, 1, 3), ErrorKind::Value, "it is inverted, swap two");
  EXPECT_ERROR(builder.add_spring(2, 2, 1.0f, 0.0f), ErrorKind::Value, "spring 0 (particles 2, 2)");
  EXPECT_ERROR(builder.add_edge(2, 3, 0, 0), ErrorKind::Value, "edge 0 (particles 2, 3, 0, 0)");
  EXPECT_ERROR(builder.add_edge(5, 2, 0, 1), ErrorKind::Value, "degenerate");
  EXPECT_ERROR(builder.add_edge(2, 2, 0, 1), ErrorKind::Value, "2 twice");
  // Out of range.
  EXPECT_ERROR(builder.add_triangle(0, 1, 6), ErrorKind::Index, "from 0 to 5, got 6");
  EXPECT_ERROR(builder.add_tetrahedron(-1, 1, 2, 3), ErrorKind::Index, "got -1");
  EXPECT_ERROR(builder.add_spring(0, 99, 1.0f, 0.0f), ErrorKind::Index, "got 99");
  EXPECT_ERROR(builder.add_edge(2, 3, -1, 1), ErrorKind::Index, "got -1");
  EXPECT_ERROR(builder.add_edge(-2, 3, 0, 1), ErrorKind::Index, "or -1, got -2");
  // Materials.
  for (const float bad : {kNan, kInf, -1.0f}) {
    EXPECT_ERROR(builder.add_spring(0, 1, bad, 0.0f), ErrorKind::Value, "ke: expected a finite");
    EXPECT_ERROR(builder.add_spring(0, 1, 1.0f, bad), ErrorKind::Value, "kd: expected a finite");
    EXPECT_ERROR(builder.add_triangle(0, 1, 2, {.drag = bad}), ErrorKind::Value, "tri_drag");
    EXPECT_ERROR(builder.add_tetrahedron(0, 1, 2, 3, 1.0f, bad), ErrorKind::Value, "k_lambda");
    EXPECT_ERROR(builder.add_edge(2, 3, 0, 1, {}, {.ke = bad}), ErrorKind::Value, "edge_ke");
  }
  EXPECT_ERROR(builder.add_edge(2, 3, 0, 1, kNan), ErrorKind::Value, "rest");
  // The third of a list: nothing of the list stays.
  const Vec3i triangles[] = {{0, 1, 2}, {0, 2, 3}, {0, 1, 5}};
  EXPECT_ERROR(builder.add_triangles(triangles), ErrorKind::Value, "triangle 2");
  const Vec4i tetrahedra[] = {{0, 1, 2, 3}, {0, 1, 2, 4}};
  EXPECT_ERROR(builder.add_tetrahedra(tetrahedra), ErrorKind::Value, "tetrahedron 1");
  const Vec4i edges[] = {{2, 3, 0, 1}, {2, 9, 0, 1}};
  EXPECT_ERROR(builder.add_edges(edges), ErrorKind::Index, "edge 1");
  const TriMaterial two[] = {{}, {}};
  EXPECT_ERROR(builder.add_triangles(triangles, two), ErrorKind::Value, "one value or 3");
  // A NaN in a position that was edited after the particle was added.
  builder.particle_q[1].x = kNan;
  EXPECT_ERROR(builder.add_triangle(0, 1, 2), ErrorKind::Value, "triangle 0");
  EXPECT_ERROR(builder.add_tetrahedron(0, 1, 2, 3), ErrorKind::Value, "tetrahedron 0");
  EXPECT_ERROR(builder.add_spring(0, 1, 1.0f, 0.0f), ErrorKind::Value, "spring 0");
  expect_untouched(builder, 6);
}

// The threshold is relative to the size.
TEST(Elements, SmallOnesOfAGoodShapeAreWelcome) {
  ModelBuilder builder;
  for (const Vec3f& x : kCorners) builder.add_particle(x * 1e-5f, {}, 1.0f);
  EXPECT_GT(builder.add_triangle(0, 1, 2), 0.0f);
  EXPECT_GT(builder.add_tetrahedron(0, 1, 2, 3), 0.0f);
}

TEST(SoftGrid, FillsItsBlockWithPositiveTetrahedraAndAClosedSurface) {
  ModelBuilder builder;
  const float s = std::sqrt(0.5f);
  builder.add_soft_grid({.placement = {.pos = {1.0f, 2.0f, 3.0f},
                                       .rot = {0.0f, 0.0f, s, s},
                                       .vel = {0.5f, 0.0f, 0.0f}},
                         .dim_x = 2,
                         .dim_y = 3,
                         .dim_z = 1,
                         .cell_x = 0.5,
                         .cell_y = 0.25,
                         .cell_z = 1.0,
                         .density = 8.0,
                         .fix_left = true,
                         .fix_top = true});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->particle_count(), 3 * 4 * 2);
  EXPECT_EQ(model->tet_count(), 5 * 6);
  EXPECT_EQ(model->tri_count(), 2 * 2 * (6 + 2 + 3));
  double volume = 0.0;
  for (const float v : model->particle_tet_volume.to_host()) {
    EXPECT_GT(v, 0.0f);
    volume += static_cast<double>(v);
  }
  EXPECT_NEAR(volume, 2 * 0.5 * 3 * 0.25 * 1.0, 1e-5);
  for (const Vec4i& e : model->particle_edge_indices.to_host()) EXPECT_TRUE(e.x >= 0 && e.y >= 0);
  EXPECT_EQ(2 * model->edge_count(), 3 * model->tri_count());  // every edge has two triangles
  // A quarter turn about z: local x becomes world y.
  const std::vector<Vec3f> q = model->particle_q.to_host();
  EXPECT_NEAR(q[1].x, 1.0f, 1e-6f);
  EXPECT_NEAR(q[1].y, 2.5f, 1e-6f);
  // A cell has 1 kg, and each of its corners an eighth of this mass.
  const std::vector<float> mass = model->particle_mass.to_host();
  for (size_t n = 0; n < mass.size(); ++n) {
    const size_t x = n % 3, y = n / 3 % 4;
    const bool fixed = x == 0 || y == 3;
    const float cells = (x == 2 ? 0.5f : 1.0f) * (y == 0 ? 0.5f : 1.0f) * 0.5f;
    EXPECT_EQ(mass[n], fixed ? 0.0f : cells) << n;
  }
}

TEST(SoftMesh, LumpsItsMassByQuartersAndTakesAMaterialForEach) {
  std::vector<Vec3f> vertices = kCorners;
  vertices.push_back({1.0f, 1.0f, 1.0f});
  const int32_t indices[] = {0, 1, 2, 3, 1, 2, 3, 4};
  const float mu[] = {1.0f, 2.0f};
  const float lambda[] = {3.0f};
  ModelBuilder builder;
  builder.add_particle({}, {}, 1.0f);  // the mesh comes after others
  builder.add_soft_mesh({.scale = 2.0,
                         .vertices = vertices,
                         .indices = indices,
                         .density = 12.0,
                         .material = {.k_mu = mu, .k_lambda = lambda}});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->particle_tet_indices.to_host(),
            (std::vector<Vec4i>{{1, 2, 3, 4}, {2, 3, 4, 5}}));
  EXPECT_EQ(model->particle_tet_material.to_host(),
            (std::vector<float>{1.0f, 3.0f, 0.0f, 2.0f, 3.0f, 0.0f}));
  EXPECT_EQ(model->tri_count(), 6);  // the face between the two is inside
  const std::vector<float> volume = model->particle_tet_volume.to_host(),
                           mass = model->particle_mass.to_host();
  EXPECT_NEAR(volume[0], 8.0f / 6.0f, 1e-6f);
  EXPECT_NEAR(volume[1], 8.0f / 3.0f, 1e-6f);
  EXPECT_NEAR(mass[1], 12.0f * volume[0] / 4.0f, 1e-5f);
  EXPECT_NEAR(mass[2], 12.0f * (volume[0] + volume[1]) / 4.0f, 1e-5f);
  EXPECT_NEAR(mass[5], 12.0f * volume[1] / 4.0f, 1e-5f);
}

TEST(SoftMesh, BrokenMeshesAreRefusedAndLeaveTheBuilderAsItWas) {
  ModelBuilder builder;
  std::vector<Vec3f> vertices = kCorners;
  const std::vector<int32_t> good = {0, 1, 2, 3};
  const auto refuse = [&](SoftMeshArgs args, ErrorKind kind, const char* text) {
    EXPECT_ERROR(builder.add_soft_mesh(args), kind, text);
    expect_untouched(builder, 0);
  };
  refuse({}, ErrorKind::Value, "empty mesh");
  refuse({.vertices = vertices}, ErrorKind::Value, "indices: expected 4");
  const int32_t three[] = {0, 1, 2}, far[] = {0, 1, 2, 4}, inverted[] = {0, 2, 1, 3};
  refuse({.vertices = vertices, .indices = three}, ErrorKind::Value, "got 3");
  refuse({.vertices = vertices, .indices = far}, ErrorKind::Index, "indices[3] (tetrahedron 0)");
  refuse({.vertices = vertices, .indices = inverted}, ErrorKind::Value, "inverted");
  vertices.push_back({5.0f, 5.0f, 5.0f});
  refuse({.vertices = vertices, .indices = good}, ErrorKind::Value, "vertices[4]");
  vertices.pop_back();
  vertices[2].y = kNan;
  refuse({.vertices = vertices, .indices = good}, ErrorKind::Value, "vertices[2]");
  vertices = kCorners;
  refuse({.scale = 0.0, .vertices = vertices, .indices = good}, ErrorKind::Value, "scale");
  refuse({.vertices = vertices, .indices = good, .density = -1.0}, ErrorKind::Value, "density");
  const float two[] = {1.0f, 2.0f}, nan[] = {kNan};
  refuse({.vertices = vertices, .indices = good, .material = {.k_mu = nan}}, ErrorKind::Value,
         "k_mu");
  const int32_t twice[] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
  refuse({.vertices = vertices, .indices = twice, .material = {.k_damp = two}}, ErrorKind::Value,
         "k_damp");
  refuse({.vertices = vertices, .indices = twice}, ErrorKind::Value,
         "more than two tetrahedra: expected a manifold mesh");
  SoftMeshArgs turned = {.vertices = vertices, .indices = good};
  turned.placement.rot = {0.0f, 0.0f, 0.0f, 2.0f};
  refuse(turned, ErrorKind::Value, "quaternion");
}

TEST(SoftMesh, TetrahedraThatShareAnEdgeOnlyNeedNoBendingEdges) {
  // Two tetrahedra on one edge: four triangles of the surface meet there.
  const Vec3f vertices[] = {{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 1.0f},  {1.0f, 0.0f, 0.0f},
                            {1.0f, 1.0f, 0.0f}, {-1.0f, 0.0f, 0.0f}, {-1.0f, -1.0f, 0.0f}};
  const int32_t indices[] = {0, 2, 3, 1, 0, 4, 5, 1};
  ModelBuilder builder;
  SoftMeshArgs args = {.vertices = vertices, .indices = indices};
  EXPECT_ERROR(builder.add_soft_mesh(args), ErrorKind::Value, "add_surface_mesh_edges");
  expect_untouched(builder, 0);
  args.add_surface_mesh_edges = false;
  builder.add_soft_mesh(args);
  EXPECT_EQ(builder.tri_count(), 8);
  EXPECT_EQ(builder.edge_count(), 0);
}

TEST(ClothGrid, HasTwoTrianglesPerCellAndFixesItsSides) {
  for (const bool reverse : {false, true}) {
    ModelBuilder builder;
    builder.add_cloth_grid({.dim_x = 3,
                            .dim_y = 2,
                            .cell_x = 0.5,
                            .cell_y = 0.25,
                            .mass = 0.125f,
                            .reverse_winding = reverse,
                            .fix_right = true,
                            .add_springs = true});
    const auto model = builder.finalize(Device::cpu());
    EXPECT_EQ(model->particle_count(), 12);
    EXPECT_EQ(model->tri_count(), 12);
    EXPECT_EQ(model->edge_count(), 3 * 3 + 2 * 4 + 6);
    for (const float area : model->particle_tri_area.to_host()) EXPECT_NEAR(area, 0.0625f, 1e-7f);
    const std::vector<float> mass = model->particle_mass.to_host();
    const std::vector<int32_t> flags = model->particle_flags.to_host();
    for (size_t n = 0; n < 12; ++n) {
      EXPECT_EQ(mass[n], n % 4 == 3 ? 0.0f : 0.125f);
      EXPECT_EQ(flags[n], n % 4 == 3 ? 0 : 1);
    }
    std::set<std::pair<int32_t, int32_t>> pairs;
    for (const Vec2i& s : model->particle_spring_indices.to_host()) {
      EXPECT_LT(s.x, s.y);
      EXPECT_TRUE(pairs.insert({s.x, s.y}).second) << s.x << " " << s.y;
    }
    EXPECT_GT(pairs.size(), static_cast<size_t>(model->edge_count()));
  }
}

TEST(ClothMesh, LumpsItsMassByThirdsAndRefusesBrokenMeshes) {
  const std::vector<int32_t> indices = {0, 1, 2, 0, 2, 3};
  ModelBuilder builder;
  builder.add_cloth_mesh({.vertices = kCorners, .indices = indices, .density = 6.0});
  EXPECT_EQ(builder.particle_mass, (std::vector<float>{2.0f, 1.0f, 2.0f, 1.0f}));
  ModelBuilder other;
  const auto refuse = [&](const ClothMeshArgs& args, ErrorKind kind, const char* text) {
    EXPECT_ERROR(other.add_cloth_mesh(args), kind, text);
    expect_untouched(other, 0);
  };
  const int32_t fan[] = {0, 1, 2, 0, 3, 1, 1, 0, 4}, far[] = {0, 1, 7}, loose[] = {0, 1, 2};
  std::vector<Vec3f> five = kCorners;
  five.push_back({0.5f, -1.0f, 0.3f});
  refuse({.vertices = five, .indices = fan}, ErrorKind::Value, "the edge (1, 0)");
  refuse({.vertices = kCorners, .indices = far}, ErrorKind::Index, "got 7");
  refuse({.vertices = kCorners, .indices = loose}, ErrorKind::Value, "vertices[3]");
  refuse({}, ErrorKind::Value, "empty mesh");
  refuse({.vertices = kCorners, .indices = indices, .density = std::nan("")}, ErrorKind::Value,
         "density");
}

TEST(Grids, BadSizesAreRefused) {
  ModelBuilder builder;
  EXPECT_ERROR(builder.add_soft_grid({.dim_x = 0}), ErrorKind::Value, "dim_x");
  EXPECT_ERROR(builder.add_soft_grid({.cell_y = -1.0}), ErrorKind::Value, "cell_y");
  EXPECT_ERROR(builder.add_soft_grid({.density = std::nan("")}), ErrorKind::Value, "density");
  EXPECT_ERROR(builder.add_soft_grid({.k_mu = kNan}), ErrorKind::Value, "k_mu");
  EXPECT_ERROR(builder.add_soft_grid({.dim_x = 4000, .dim_y = 4000, .dim_z = 4000}),
               ErrorKind::Value, "at most 2147483647");
  EXPECT_ERROR(builder.add_cloth_grid({.dim_y = 0}), ErrorKind::Value, "dim_y");
  EXPECT_ERROR(builder.add_cloth_grid({.cell_x = 0.0}), ErrorKind::Value, "cell_x");
  EXPECT_ERROR(builder.add_cloth_grid({.mass = -1.0f}), ErrorKind::Value, "mass");
  EXPECT_ERROR(builder.add_cloth_grid({.edge = {.kd = kInf}}), ErrorKind::Value, "edge_kd");
  EXPECT_ERROR(builder.add_particle_grid({.dim_z = -1}), ErrorKind::Value, "dim_z");
  EXPECT_ERROR(builder.add_particle_grid({.jitter = -1.0}), ErrorKind::Value, "jitter");
  expect_untouched(builder, 0);
}

TEST(ParticleGrid, HasNewtonsOrderAndRepeatableNoise) {
  ModelBuilder plain;
  plain.add_particle_grid({.dim_x = 2,
                           .dim_y = 2,
                           .dim_z = 3,
                           .cell_x = 1.0,
                           .cell_y = 2.0,
                           .cell_z = 4.0,
                           .mass = 0.5f});
  ASSERT_EQ(plain.particle_count(), 12);
  EXPECT_EQ(plain.particle_q[1], (Vec3f{0.0f, 0.0f, 4.0f}));
  EXPECT_EQ(plain.particle_q[3], (Vec3f{1.0f, 0.0f, 0.0f}));
  EXPECT_EQ(plain.particle_q[6], (Vec3f{0.0f, 2.0f, 0.0f}));
  const ParticleGridArgs noisy = {.dim_x = 5,
                                  .dim_y = 5,
                                  .dim_z = 5,
                                  .jitter = 0.02,
                                  .radius_mean = 0.1f,
                                  .radius_std = 0.01,
                                  .seed = 3};
  ModelBuilder a, b, c;
  a.add_particle_grid(noisy);
  b.add_particle_grid(noisy);
  ParticleGridArgs other = noisy;
  other.seed = 4;
  c.add_particle_grid(other);
  EXPECT_EQ(a.particle_q, b.particle_q);
  EXPECT_EQ(a.particle_radius, b.particle_radius);
  EXPECT_NE(a.particle_q, c.particle_q);
  float mean = 0.0f;
  for (size_t n = 0; n < a.particle_radius.size(); ++n) mean += a.particle_radius[n] / 125.0f;
  EXPECT_NEAR(mean, 0.1f, 0.005f);
  EXPECT_LE(std::fabs(a.particle_q[0].x), 0.01f);
}

}  // namespace
}  // namespace novaphy
