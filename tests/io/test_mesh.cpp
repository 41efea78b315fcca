// Triangle meshes from files: a known cube in every format, scenes, and every bad file.
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "io/cubes.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/io/mesh.h"
#include "support/bits.h"
#include "support/temporary_folder.h"

namespace novaphy {
namespace {

using namespace testing;  // NOLINT: the helpers of tests
using namespace std::string_literals;

double volume(const Mesh& mesh) {
  double sum = 0.0;
  for (size_t n = 0; n < mesh.indices.size(); n += 3) {
    const auto at = [&](size_t c) {
      const Vec3f v = mesh.vertices[static_cast<size_t>(mesh.indices[n + c])];
      return Vec3<double>{v.x, v.y, v.z};
    };
    sum += math::dot(at(0), math::cross(at(1), at(2))) / 6.0;
  }
  return sum;
}

using Corners = std::set<std::array<float, 3>>;
Corners corners_of(const Mesh& mesh) {
  Corners corners;
  for (const Vec3f& v : mesh.vertices) corners.insert({v.x, v.y, v.z});
  return corners;
}
// The corners of a box between two points.
Corners box(const Vec3f& low, const Vec3f& high) {
  Corners corners;
  for (const float x : {low.x, high.x})
    for (const float y : {low.y, high.y})
      for (const float z : {low.z, high.z}) corners.insert({x, y, z});
  return corners;
}

class LoadMesh : public ::testing::Test {
 protected:
  Mesh load(std::string_view name, const std::string& bytes, const MeshOptions& options = {}) {
    return load_mesh(folder_.write(name, bytes), options);
  }
  void refuse(std::string_view name, const std::string& bytes, const std::string& text) {
    try {
      const Mesh mesh = load(name, bytes);
      ADD_FAILURE() << "did not throw: " << name << ": " << mesh.vertices.size() << " vertices, "
                    << mesh.indices.size() << " indices";
    } catch (const Error& error) {
      const std::string message = error.what();
      EXPECT_EQ(error.kind(), ErrorKind::Value) << message;
      EXPECT_EQ(message.find("load_mesh: " + (folder_.path() / name).string()), 0u) << message;
      EXPECT_NE(message.find(text), std::string::npos) << text << " in: " << message;
    }
  }
  TemporaryFolder folder_;
};

TEST_F(LoadMesh, ReadsTheSameCubeInAllFormats) {
  const std::map<std::string, std::string> files = {
      {"cube.obj", cube_obj()},           {"CUBE.OBJ", cube_obj()},
      {"cube.stl", cube_stl()},           {"binary.stl", cube_binary_stl()},
      {"cube.ply", cube_ply()},           {"little.ply", cube_binary_ply(false)},
      {"big.ply", cube_binary_ply(true)}, {"cube.dae", cube_dae(kMetresZUp, kCubeNode)}};
  for (const auto& [name, bytes] : files) {
    SCOPED_TRACE(name);
    const Mesh mesh = load(name, bytes);
    EXPECT_EQ(mesh.vertices.size(), 8u);
    EXPECT_EQ(mesh.indices.size(), 36u);
    EXPECT_EQ(corners_of(mesh), box({0, 0, 0}, {1, 1, 1}));
    EXPECT_NEAR(volume(mesh), 1.0, 1e-12);
    // A closed surface: every edge once in each direction.
    std::set<std::pair<int32_t, int32_t>> edges;
    for (size_t n = 0; n < 36; n += 3)
      for (size_t c = 0; c < 3; ++c)
        EXPECT_TRUE(edges.insert({mesh.indices[n + c], mesh.indices[n + (c + 1) % 3]}).second);
    for (const auto& [a, b] : edges) EXPECT_TRUE(edges.contains({b, a})) << a << " " << b;

    ModelBuilder builder;
    builder.add_cloth_mesh({.vertices = mesh.vertices, .indices = mesh.indices, .density = 0.5});
    EXPECT_EQ(builder.edge_count(), 18);
    float mass = 0.0f;
    for (const float m : builder.particle_mass) mass += m;
    EXPECT_NEAR(mass, 0.5f * 6.0f, 1e-6f);
  }
}

TEST_F(LoadMesh, VerticesComeInTheOrderOfTheirFirstUse) {
  const Mesh mesh =
      load("a.obj", "v 5 0 0\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 2 3 4\nf 4 3 5\n");
  EXPECT_EQ(mesh.vertices,
            (std::vector<Vec3f>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}}));  // not the loose one
  EXPECT_EQ(mesh.indices, (std::vector<int32_t>{0, 1, 2, 2, 1, 3}));
}

TEST_F(LoadMesh, LooseVerticesPointsAndLinesAreLeftOutInAllFormats) {
  std::string ply = cube_ply();
  ply.replace(ply.find("vertex 8"), 8, "vertex 9");
  ply.insert(ply.find("4 0 2"), "9 9 9\n");
  EXPECT_EQ(corners_of(load("a.ply", ply)), box({0, 0, 0}, {1, 1, 1}));
  const Mesh mesh = load("a.obj", cube_obj() + "v 9 9 9\nv 8 8 8\np 9\nl 9 10\n");
  EXPECT_EQ(corners_of(mesh), box({0, 0, 0}, {1, 1, 1}));
  EXPECT_EQ(mesh.indices.size(), 36u);
}

TEST_F(LoadMesh, PolygonsAreCutIntoTriangles) {
  // An L of six corners, which a fan from its first corner would not fill: area 3.
  const Mesh mesh =
      load("l.obj", "v 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nv 0 0 0\nv 2 0 0\nf 1 2 3 4 5 6\n");
  EXPECT_EQ(mesh.vertices.size(), 6u);
  EXPECT_EQ(mesh.indices.size(), 12u);
  ModelBuilder builder;
  builder.add_cloth_mesh({.vertices = mesh.vertices, .indices = mesh.indices, .density = 1.0});
  float area = 0.0f;
  for (const float m : builder.particle_mass) area += m;
  EXPECT_NEAR(area, 3.0f, 1e-6f);
}

TEST_F(LoadMesh, JoinsVerticesOverNormalsMaterialsAndZeros) {
  // Two materials, two normals, and a -0: still one square.
  const std::string text =
      "v 0 0 0\nv 1 0 0\nv 1 1 0\nv -0.0 0 -0.0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nvn 0 1 0\n"
      "usemtl a\nf 1//1 2//1 3//1\nusemtl b\nf 4//2 5//2 6//2\n";
  const Mesh joined = load("a.obj", text);
  EXPECT_EQ(joined.vertices.size(), 4u);
  EXPECT_EQ(joined.indices, (std::vector<int32_t>{0, 1, 2, 0, 2, 3}));
  const Mesh apart = load("a.obj", text, {.join_vertices = false});
  EXPECT_EQ(apart.vertices.size(), 6u);
  EXPECT_EQ(apart.indices, (std::vector<int32_t>{0, 1, 2, 3, 4, 5}));
}

TEST_F(LoadMesh, SceneNodesPlaceTheirMeshes) {
  const std::string cube = "<instance_geometry url=\"#cube\"/>";
  const std::string nodes =
      "<node><translate>10 0 0</translate><scale>2 2 2</scale><node>"
      "<translate>0 0 1</translate>" +
      cube +
      "</node></node>"
      "<node><scale>-1 1 1</scale>" +
      cube + "</node>";
  const Mesh mesh = load("a.dae", cube_dae(kMetresZUp, nodes));
  EXPECT_EQ(mesh.indices.size(), 72u);
  Corners expected = box({10, 0, 2}, {12, 2, 4});
  expected.merge(box({-1, 0, 0}, {0, 1, 1}));
  EXPECT_EQ(corners_of(mesh), expected);
  EXPECT_NEAR(volume(mesh), 8.0 + 1.0, 1e-5);  // the mirrored one is not inside out
}

TEST_F(LoadMesh, ColladaComesInMetresWithZUp) {
  const std::string node =
      "<node><translate>0 10 0</translate><scale>1 2 4</scale>"
      "<instance_geometry url=\"#cube\"/></node>";
  const auto at = [&](const char* asset) {
    const Mesh mesh = load("a.dae", cube_dae(asset, node));
    EXPECT_GT(volume(mesh), 0.0);
    return corners_of(mesh);
  };
  EXPECT_EQ(at("<unit meter=\"1\"/><up_axis>Z_UP</up_axis>"), box({0, 10, 0}, {1, 12, 4}));
  EXPECT_EQ(at("<unit meter=\"0.5\"/><up_axis>Z_UP</up_axis>"), box({0, 5, 0}, {0.5f, 6, 2}));
  // With y up, (x, y, z) becomes (x, -z, y).
  EXPECT_EQ(at("<unit meter=\"1\"/><up_axis>Y_UP</up_axis>"), box({0, -4, 10}, {1, 0, 12}));
  EXPECT_EQ(at("<unit meter=\"0.5\"/><up_axis>Y_UP</up_axis>"), box({0, -2, 5}, {0.5f, 0, 6}));
}

TEST_F(LoadMesh, OtherFormatsKeepTheirNumbers) {
  const Mesh mesh = load("a.obj", "v 0 0 0\nv 250 0 0\nv 0 0.5 -3\nf 1 2 3\n");
  EXPECT_EQ(mesh.vertices, (std::vector<Vec3f>{{0, 0, 0}, {250, 0, 0}, {0, 0.5f, -3}}));
}

TEST_F(LoadMesh, NumbersMayLeaveOutWhatIsZero) {
  const std::vector<Vec3f> expected = {{0.5f, -0.5f, 0.25f}, {2, -3, 40}, {50, 1, -100}};
  const std::string rows[] = {".5 -.5 +.25", "2. -3. 4.e1", "5.E+1 +1 -1e2"};
  const auto is_expected = [&](const Mesh& mesh) {
    EXPECT_EQ(mesh.vertices, expected);
    EXPECT_EQ(mesh.indices, (std::vector<int32_t>{0, 1, 2}));
  };
  is_expected(load("a.obj", "v " + rows[0] + "\nv " + rows[1] + "\nv " + rows[2] + "\nf 1 2 3\n"));
  is_expected(load("a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex " + rows[0] +
                                "\nvertex " + rows[1] + "\nvertex " + rows[2] +
                                "\nendloop\nendfacet\nendsolid a\n"));
  is_expected(load("a.ply",
                   "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                   "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
                   "end_header\n" +
                       rows[0] + "\n" + rows[1] + "\n" + rows[2] + "\n3 0 1 2\n"));
  std::string dae = cube_dae(kMetresZUp, kCubeNode);
  const size_t at = dae.find("count=\"24\">") + 11;
  dae.replace(at, dae.find("</float_array>") - at,
              rows[0] + " " + rows[1] + " " + rows[2] + " 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0");
  const Corners corners = corners_of(load("a.dae", dae, {.drop_degenerate = true}));
  for (const Vec3f& v : expected) EXPECT_TRUE(corners.contains({v.x, v.y, v.z}));
}

TEST_F(LoadMesh, EveryVertexOfAnObjFileCounts) {
  const std::vector<Vec3f> expected = {{0.5f, 0, 0}, {1, 0, 0}, {0, 2, 0}};
  for (const std::string& text :
       {"\xEF\xBB\xBFv .5 0 0\n  v 1 0 0\n\tv 0 2 0\n  f 1 2 3\n"s,      // set in
        "v .5 0 0 .1 .2 .3\nv 1 0 0 1 1 1 .5\nv 0 1 0 0.5\nf 1 2 3\n"s,  // colors, w
        "mtllib none.mtl\nvt .5\nvn .5 .5 .5\nv .5 0 0\nv 1 0 0 # 4\nv 0 2 0\n"
        "f 1/1/1 2/1/1 3/1/1 # 4\n"s,
        "v .5 0 \\\n0\nv 1 0 0\nv 0 2 0\nf 1 2 \\\n3\n"s,  // continued lines
        "v .5 0 0\rv 1 0 0\rv 0 2 0\rf 1 2 3\r"s,
        "v .5 0 0\r\nv 1 0 0\r\nv 0 2 0\r\nf 1 2 3\r\n"s}) {
    SCOPED_TRACE(text);
    EXPECT_EQ(load("a.obj", text).vertices, expected);
  }
  for (const char* bad : {"v 1 2", "v 1 2 3 4 5", "v 1 2 x", "v 1,5 2 3", "v 1d2 2 3", "v"})
    refuse("a.obj", std::string("v 0 0 0\n") + bad + "\nv 0 1 0\nf 1 2 3\n",
           "a.obj:2: expected v and 3 numbers");
}

TEST_F(LoadMesh, WhatIsNoMeshIsNotChecked) {
  const auto camera = [](const std::string& id) {
    return "<camera id=\"" + id +
           "\" name=\"C\"><optics><technique_common><perspective><xfov>49</xfov><znear>9</znear>"
           "<zfar>1</zfar></perspective></technique_common></optics></camera>";
  };
  const std::string light =
      "<library_lights><light id=\"l\" name=\"L\"><technique_common><point><color>1 1 1</color>"
      "</point></technique_common></light></library_lights>";
  std::string dae =
      cube_dae(kMetresZUp, kCubeNode +
                               "<node name=\"C\"><instance_camera url=\"#a\"/></node>"
                               "<node name=\"C\"><instance_camera url=\"#b\"/></node>"
                               "<node name=\"L\"><instance_light url=\"#l\"/></node>"
                               "<node name=\"L\"><instance_light url=\"#l\"/></node>");
  dae.insert(dae.find("<library_geometries>"),
             "<library_cameras>" + camera("a") + camera("b") + "</library_cameras>" + light);
  EXPECT_EQ(corners_of(load("a.dae", dae)), box({0, 0, 0}, {1, 1, 1}));
}

TEST_F(LoadMesh, RefusesWhatIsNoFileAndOtherEndings) {
  EXPECT_ERROR(load_mesh(folder_.path() / "none.obj"), ErrorKind::Value, "No such file");
  std::filesystem::create_directory(folder_.path() / "folder.obj");
  EXPECT_ERROR(load_mesh(folder_.path() / "folder.obj"), ErrorKind::Value, "got a folder");
  refuse("cube.fbx", cube_obj(), ".obj, .stl, .ply, .dae or .glb, got .fbx");
  refuse("cube", cube_obj(), "without an ending");
}

TEST_F(LoadMesh, ReadsAFileAsWhatItsNameSays) {
  refuse("cube.dae", cube_obj(), "whole .dae file; assimp says");
  refuse("cube.ply", cube_stl(), ":1: expected ply");
  refuse("cube.stl", cube_ply(), "whole .stl file; assimp says");
}

TEST_F(LoadMesh, RefusesBrokenAndEmptyFiles) {
  for (const char* name : {"a.obj", "a.stl", "a.ply", "a.dae"}) {
    SCOPED_TRACE(name);
    refuse(name, "", name);
    refuse(name, "nothing of the kind\n", name);
  }
  const std::string stl = cube_binary_stl(), ply = cube_ply(),
                    dae = cube_dae(kMetresZUp, kCubeNode);
  refuse("a.stl", stl.substr(0, stl.size() - 60), "whole .stl file; assimp says");
  for (size_t end = 0; end + 1 < ply.size(); end += 7) {  // at every place of a text
    SCOPED_TRACE(end);
    if (ply.find('\n', end) + 1 < ply.size()) refuse("a.ply", ply.substr(0, end), "a.ply");
  }
  refuse("a.ply", ply.substr(0, ply.find("end_header")), "expected end_header, got the end");
  refuse("a.ply", ply.substr(0, ply.find("4 4 5")), "6 rows of element 1, as the header says");
  for (const bool big_endian : {false, true}) {
    const std::string binary = cube_binary_ply(big_endian);
    for (size_t end = 0; end < binary.size(); end += 3) {
      SCOPED_TRACE(end);
      refuse("a.ply", binary.substr(0, end), "a.ply");
    }
  }
  const std::string text = cube_stl();
  refuse("a.stl", text.substr(0, text.size() / 2), "expected endsolid, got the end of the file");
  refuse("a.dae", dae.substr(0, dae.size() / 2), "whole .dae file; assimp says");
  for (const char* bad : {"x", "1.5", "\xff", "/"}) {  // assimp would fill the memory
    std::string broken = dae;
    broken.replace(broken.find("<p>0") + 3, 1, bad);
    refuse("a.dae", broken, "a.dae:9: expected whole numbers in <p>");
  }
}

TEST_F(LoadMesh, RefusesMeshesWithoutATriangle) {
  refuse("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "a.obj");
  refuse("a.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "a.obj");
  refuse("a.stl", "solid a\nendsolid a\n", "a.stl");
  refuse("a.dae", cube_dae(kMetresZUp, ""), "a.dae");
  std::string ply = cube_ply();
  ply.replace(ply.find("face 6"), 6, "face 0");
  refuse("a.ply", ply.substr(0, ply.find("4 0 2")), "a.ply");
}

TEST_F(LoadMesh, RefusesIndicesOutOfRange) {
  refuse("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "assimp says");
  std::string ply = cube_ply();
  ply.replace(ply.find("4 0 2"), 5, "4 8 2");
  refuse("a.ply", ply, "mesh 0, face 0: expected corners from 0 to 7, got 8");
  ply.replace(ply.find("4 8 2"), 5, "4-1 2");
  refuse("a.ply", ply, "a.ply");
}

TEST_F(LoadMesh, RefusesPositionsThatAreNotFinite) {
  for (const char* bad : {"nan", "inf", "-inf", "1e39"})
    refuse("a.obj", std::string("v 0 0 0\nv 1 0 0\nv 0 ") + bad + " 0\nf 1 2 3\n",
           "triangle 0: expected finite");
}

TEST_F(LoadMesh, TrianglesWithEqualCornersAreRefusedOrLeftOut) {
  const std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 1 0\nf 1 2 3\nf 2 3 4\nf 1 1 3\n";
  refuse("a.obj", text, "triangle 1: expected three different corners");
  refuse("a.obj", text, "2 of 3 triangles");
  const Mesh mesh = load("a.obj", text, {.drop_degenerate = true});
  EXPECT_EQ(mesh.vertices.size(), 3u);
  EXPECT_EQ(mesh.indices, (std::vector<int32_t>{0, 1, 2}));
  EXPECT_ERROR(load("b.obj", "v 0 0 0\nv 1 0 0\nf 1 2 2\n", {.drop_degenerate = true}),
               ErrorKind::Value, "degenerate ones only");
}

}  // namespace
}  // namespace novaphy
