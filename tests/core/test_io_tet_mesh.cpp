// Tetrahedral meshes from MSH 4.1 files: a known cube, and every kind of invalid file.
#include <gtest/gtest.h>

#include <limits>

#include "novaphy/core/io/tet_mesh.h"
#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"
#include "support/temporary_folder.h"

namespace novaphy {
namespace {

using testing::TemporaryFolder;

const std::string kFormat = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n";

// "tag x y z" of each node, and "tag a b c d" of each tetrahedron, as a file.
std::string msh(const std::vector<std::string>& nodes, const std::vector<std::string>& elements,
                const std::string& format = kFormat) {
  const std::string n = std::to_string(nodes.size()), m = std::to_string(elements.size());
  std::string tags, positions, text = format;
  for (const std::string& node : nodes) {
    const size_t space = node.find(' ');
    tags += node.substr(0, space) + "\n";
    positions += node.substr(space + 1) + "\n";
  }
  text += "$Nodes\n1 " + n + " 1 9\n3 1 0 " + n + "\n" + tags + positions + "$EndNodes\n";
  text += "$Elements\n1 " + m + " 1 9\n3 1 4 " + m + "\n";
  for (const std::string& element : elements) text += element + "\n";
  return text + "$EndElements\n";
}

const std::vector<std::string> kNodes = {"1 0 0 0", "2 1 0 0", "3 0 1 0", "4 0 0 1"};
const std::vector<std::string> kElements = {"7 1 2 3 4"};

std::string replaced(std::string text, std::string_view what, std::string_view with) {
  const size_t at = text.find(what);
  EXPECT_NE(at, std::string::npos) << what;
  return text.replace(at, what.size(), with);
}

class LoadTetMesh : public ::testing::Test {
 protected:
  TetMesh load(const std::string& text, const TetMeshOptions& options = {}) {
    return load_tet_mesh(folder_.write("a.msh", text), options);
  }
  // Expects that the message names the file and contains all of `parts`.
  void refuse(const std::string& text, const std::vector<std::string>& parts) {
    try {
      load(text);
      ADD_FAILURE() << "did not throw: " << parts[0];
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Value);
      const std::string message = error.what();
      EXPECT_NE(message.find((folder_.path() / "a.msh").string()), std::string::npos) << message;
      for (const std::string& part : parts)
        EXPECT_NE(message.find(part), std::string::npos) << part << " in: " << message;
    }
  }
  TemporaryFolder folder_;
};

TEST_F(LoadTetMesh, ReadsACubeWithSurfacesParametersAndGapsInTheTags) {
  const TetMesh mesh = load_tet_mesh(NOVAPHY_TEST_DATA "/cube.msh");
  const std::vector<Vec3f> corners = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0},
                                      {0, 0, 1}, {1, 0, 1}, {0, 1, 1}, {1, 1, 1}};
  EXPECT_EQ(mesh.vertices, corners);
  const std::vector<int32_t> indices = {0, 1, 2, 4, 3, 2, 1, 7, 5, 4, 7, 1, 6, 7, 4, 2, 1, 2, 4, 7};
  EXPECT_EQ(mesh.indices, indices);

  ModelBuilder builder;
  builder.add_soft_mesh({.vertices = mesh.vertices, .indices = mesh.indices, .density = 6.0});
  EXPECT_EQ(builder.tri_count(), 12);
  double mass = 0.0;
  for (const float m : builder.particle_mass) mass += static_cast<double>(m);
  EXPECT_NEAR(mass, 6.0, 1e-5);  // the volume is 1
}

TEST_F(LoadTetMesh, TakesSectionsInAnyOrderAndAnyLineEnds) {
  const TetMesh plain = load(msh(kNodes, kElements));
  EXPECT_EQ(plain.indices, (std::vector<int32_t>{0, 1, 2, 3}));
  const std::string text = msh(kNodes, kElements);
  const size_t nodes = text.find("$Nodes"), elements = text.find("$Elements");
  std::string turned = kFormat + text.substr(elements) + text.substr(nodes, elements - nodes);
  for (size_t at = 0; (at = turned.find('\n', at)) != std::string::npos; at += 2)
    turned.insert(at, "\r");
  const TetMesh same = load(turned);
  EXPECT_EQ(same.vertices, plain.vertices);
  EXPECT_EQ(same.indices, plain.indices);
}

TEST_F(LoadTetMesh, KeepsTheNearestFloats) {
  std::vector<std::string> nodes = kNodes;
  nodes[1] = "2 1.1 0 0";
  nodes[2] = "3 0 3e-1 0";
  nodes[3] = "4 -0.5 1e-3 0.70000000000000007";
  const TetMesh mesh = load(msh(nodes, kElements));
  EXPECT_EQ(mesh.vertices[1].x, 1.1f);
  EXPECT_EQ(mesh.vertices[2].y, 0.3f);
  EXPECT_EQ(mesh.vertices[3], (Vec3f{-0.5f, 1e-3f, 0.7f}));
}

TEST_F(LoadTetMesh, RefusesWhatIsNoFile) {
  EXPECT_ERROR(load_tet_mesh(folder_.path() / "none.msh"), ErrorKind::Value, "No such file");
  EXPECT_ERROR(load_tet_mesh(folder_.path()), ErrorKind::Value, "got a folder");
}

TEST_F(LoadTetMesh, RefusesOtherFormats) {
  refuse("", {":1:", "$MeshFormat", "the end of the file"});
  refuse("solid cube\n", {":1:", "$MeshFormat", "got \"solid\""});
  refuse(std::string("\x80\x01\x1b[31m\0x", 9), {"got \"??"});  // nothing a terminal acts on
  refuse("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n", {":2:", "4.1", "\"2.2\"", "-format msh41"});
  refuse("$MeshFormat\n4.1 1 8\n", {":2:", "ASCII", "binary"});
}

TEST_F(LoadTetMesh, RefusesBrokenFilesAndNamesTheLine) {
  const std::string good = msh(kNodes, kElements);
  // Cut anywhere, the file is refused: never read as a smaller mesh, never a crash.
  for (size_t length = 0; length + 1 < good.size(); ++length) {
    SCOPED_TRACE(length);
    refuse(good.substr(0, length), {"load_tet_mesh: "});
  }
  refuse(kFormat, {"a section $Nodes, got none"});
  refuse(good.substr(0, good.find("$Elements")), {"a section $Elements, got none"});
  refuse(good + good.substr(good.find("$Nodes")), {"a second"});
  refuse(good + "$EndNodes\n", {"expected a section", "\"$EndNodes\""});
  refuse(replaced(good, "$EndNodes", "$EndElements"), {":15:", "$EndNodes", "\"$EndElements\""});
  refuse(replaced(good, "1 4 1 9", "1 5 1 9"), {"expected 5 nodes", "got 4"});
  refuse(replaced(good, "1 1 1 9", "1 2 1 9"), {"expected 2 elements", "got 1"});
  refuse(replaced(good, "3 1 0 4", "7 1 0 4"), {":6:", "dimension of 0 to 3, got 7"});
  refuse(replaced(good, "3 1 0 4", "3 1 2 4"), {":6:", "parametric", "got 2"});
  refuse(replaced(good, "3 1 0 4", "3 1 0 -4"), {":6:", "number of nodes", "got -4"});
  // A number that would ask for all memory.
  refuse(replaced(good, "1 4 1 9", "1 99999999999 1 9"), {":5:", "file of this length"});
  refuse(replaced(good, "1 4 1 9", "1 99999999999999999999 1 9"), {":5:", "number of nodes"});
  refuse(replaced(good, "0 1 0\n", "0 one 0\n"), {":13:", "a coordinate", "\"one\""});
  refuse(replaced(good, "0 1 0\n", "0 1,5 0\n"), {":13:", "a coordinate", "\"1,5\""});
  refuse(replaced(good, "7 1 2 3 4", "7 1 2 3"), {"a node tag", "\"$EndElements\""});
  refuse(replaced(good, "7 1 2 3 4", "7 1 2 3 4.5"), {":19:", "a node tag", "\"4.5\""});
  refuse(replaced(good, "1\n2\n3\n4\n", "1\n2\n2\n4\n"), {":9:", "node 2", "again"});
}

TEST_F(LoadTetMesh, RefusesPositionsThatAreNotFinite) {
  for (const char* bad : {"nan", "inf", "-inf", "1e39"}) {
    std::vector<std::string> nodes = kNodes;
    nodes[2] = std::string("3 0 ") + bad + " 0";
    refuse(msh(nodes, kElements), {":13:", "node 3", "finite"});
  }
}

TEST_F(LoadTetMesh, RefusesUnknownNodes) {
  refuse(msh(kNodes, {"7 1 2 3 9"}), {":19:", "element 7", "got 9"});
  refuse(msh(kNodes, {"7 1 2 3 -1"}), {"element 7", "got -1"});
}

TEST_F(LoadTetMesh, RefusesMeshesWithoutTetrahedraAndOtherSolids) {
  refuse(msh(kNodes, {}), {"an empty mesh"});
  refuse(msh({}, {}), {"an empty mesh"});
  const std::string text = msh(kNodes, kElements);
  refuse(replaced(text, "3 1 4 1", "2 1 2 1"), {"an empty mesh"});
  refuse(replaced(text, "3 1 4 1", "3 1 5 1"), {":18:", "hexahedra (type 5)"});
  refuse(replaced(text, "3 1 4 1", "3 1 11 1"), {":18:", "10 nodes (second order) (type 11)"});
  refuse(replaced(text, "3 1 4 1", "3 1 92 1"), {":18:", "type 92"});
}

TEST_F(LoadTetMesh, CountsDegenerateAndInvertedTetrahedra) {
  std::vector<std::string> nodes = kNodes;
  nodes.push_back("5 1 1 0");
  nodes.push_back("6 0 0 2");
  refuse(msh(nodes, {"7 1 2 3 4", "8 1 3 2 6"}),
         {":24:", "tetrahedron 1 (element 8) is inverted",
          "of 2 tetrahedra 0 are degenerate and 1 inverted"});
  refuse(msh(nodes, {"7 1 2 3 5", "8 1 3 2 6", "9 1 1 1 1"}),
         {":23:", "tetrahedron 0 (element 7) is degenerate",
          "of 3 tetrahedra 2 are degenerate and 1 inverted"});
}

TEST_F(LoadTetMesh, RefusesFacesThatAreNotManifold) {
  std::vector<std::string> nodes = kNodes;
  nodes.push_back("5 0 0 -1");
  nodes.push_back("6 0 0 2");
  // Two on one face, on its two sides: good.
  EXPECT_EQ(load(msh({nodes.begin(), nodes.end() - 1}, {"7 1 2 3 4", "8 1 3 2 5"})).indices.size(),
            8u);
  refuse(msh(nodes, {"7 1 2 3 4", "8 1 3 2 5", "9 1 2 3 6"}),
         {"the face of the nodes (1, 2, 3)", "more than two"});
  nodes.erase(nodes.begin() + 4);
  refuse(msh(nodes, {"7 1 2 3 4", "8 1 2 3 6"}),
         {"the face of the nodes (1, 2, 3)", "the elements 7 and 8 on one side"});
  refuse(msh(kNodes, {"7 1 2 3 4", "8 2 3 1 4"}), {"the elements 7 and 8 on one side"});
}

TEST_F(LoadTetMesh, LooseVerticesAreRefusedOrLeftOut) {
  std::vector<std::string> nodes = kNodes;
  nodes.insert(nodes.begin() + 1, {"50 9 9 9", "51 8 8 8"});
  const std::string text = msh(nodes, kElements);
  refuse(text, {"node 50", "loose", "2 of 6", "drop_loose_vertices"});
  const TetMesh mesh = load(text, {.drop_loose_vertices = true});
  const TetMesh clean = load(msh(kNodes, kElements));
  EXPECT_EQ(mesh.vertices, clean.vertices);
  EXPECT_EQ(mesh.indices, clean.indices);
}

}  // namespace
}  // namespace novaphy
