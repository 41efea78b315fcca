#include "novaphy/core/io/tet_mesh.h"

#include <algorithm>
#include <array>
#include <tuple>
#include <utility>

#include "msh_file.h"
#include "novaphy/core/io/file.h"
#include "sim/rest_shape.h"

namespace novaphy {
namespace {

using detail::MshFile;
using detail::Words;

// Checks that every tetrahedron has a positive volume, by the rule of
// ModelBuilder::add_tetrahedron.
void check_volumes(const MshFile& file, const Words& words) {
  size_t inverted = 0, degenerate = 0, first = 0;
  double first_relative = 0.0;
  for (size_t n = 0; n < file.tetrahedra.size(); ++n) {
    const auto& nodes = file.tetrahedra[n].nodes;
    const auto at = [&](size_t c) { return file.positions[static_cast<size_t>(nodes[c])]; };
    const double relative = detail::tetrahedron_rest(at(0), at(1), at(2), at(3)).relative;
    if (relative > detail::kSmallestRelativeSize) continue;
    if (inverted + degenerate == 0) {
      first = n;
      first_relative = relative;
    }
    // The relative volume is NaN if all corners coincide; this counts as degenerate.
    ++(relative < -detail::kSmallestRelativeSize ? inverted : degenerate);
  }
  if (inverted + degenerate == 0) return;
  const bool is_inverted = first_relative < -detail::kSmallestRelativeSize;
  words.check_at(file.tetrahedra[first].line, false, "tetrahedron ", first, " (element ",
                 file.tetrahedra[first].tag, ") is ", is_inverted ? "inverted" : "degenerate",
                 ": expected a volume above ", detail::kSmallestRelativeSize,
                 " of its longest edge cubed, got ", first_relative, "; of ",
                 file.tetrahedra.size(), " tetrahedra ", degenerate, " are degenerate and ",
                 inverted, " inverted");
}

struct Face {
  std::array<int32_t, 3> nodes;  // sorted
  bool odd;                      // whether sorting reversed the orientation
  size_t tetrahedron;
  bool operator<(const Face& other) const {
    return std::tie(nodes, tetrahedron) < std::tie(other.nodes, other.tetrahedron);
  }
};

Face sorted_face(int32_t a, int32_t b, int32_t c, size_t tetrahedron) {
  bool odd = false;
  const auto order = [&odd](int32_t& low, int32_t& high) {
    if (low <= high) return;
    std::swap(low, high);
    odd = !odd;
  };
  order(a, b);
  order(b, c);
  order(a, b);
  return {{a, b, c}, odd, tetrahedron};
}

// Checks that a face has at most one tetrahedron on each side.
void check_manifold(const MshFile& file, const Words& words) {
  std::vector<Face> faces;
  faces.reserve(4 * file.tetrahedra.size());
  for (size_t n = 0; n < file.tetrahedra.size(); ++n) {
    const auto [i, j, k, l] = file.tetrahedra[n].nodes;
    faces.push_back(sorted_face(i, k, j, n));
    faces.push_back(sorted_face(j, k, l, n));
    faces.push_back(sorted_face(i, j, l, n));
    faces.push_back(sorted_face(i, l, k, n));
  }
  std::sort(faces.begin(), faces.end());
  for (size_t n = 1; n < faces.size(); ++n) {
    const Face &a = faces[n - 1], &b = faces[n];
    if (a.nodes != b.nodes) continue;
    const auto tag = [&](size_t corner) {
      return file.node_tags[static_cast<size_t>(b.nodes[corner])];
    };
    const auto check = [&](bool condition, const auto&... got) {
      words.check_at(file.tetrahedra[b.tetrahedron].line, condition, "the face of the nodes (",
                     tag(0), ", ", tag(1), ", ", tag(2),
                     "): expected at most one tetrahedron on each side, got ", got...);
    };
    check(n + 1 == faces.size() || faces[n + 1].nodes != b.nodes, "more than two");
    check(a.odd != b.odd, "the elements ", file.tetrahedra[a.tetrahedron].tag, " and ",
          file.tetrahedra[b.tetrahedron].tag, " on one side");
  }
}

// Maps each vertex to its new row; -1 for a vertex that is dropped.
std::vector<int32_t> kept_rows(const MshFile& file, const Words& words, bool drop_loose) {
  std::vector<int32_t> rows(file.positions.size(), -1);
  for (const auto& tetrahedron : file.tetrahedra)
    for (const int32_t node : tetrahedron.nodes) rows[static_cast<size_t>(node)] = 0;
  const auto loose = std::count(rows.begin(), rows.end(), -1);
  if (loose > 0 && !drop_loose) {
    const auto first = std::find(rows.begin(), rows.end(), -1) - rows.begin();
    fail(ErrorKind::Value, words.where(), ": node ", file.node_tags[static_cast<size_t>(first)],
         ": expected a node that a tetrahedron uses, got a loose one, which has no mass (", loose,
         " of ", rows.size(), " are loose; drop_loose_vertices leaves them out)");
  }
  int32_t next = 0;
  for (int32_t& row : rows)
    if (row >= 0) row = next++;
  return rows;
}

}  // namespace

TetMesh load_tet_mesh(const std::filesystem::path& path, const TetMeshOptions& options) {
  constexpr std::string_view name = "load_tet_mesh";
  const std::string text = read_file(name, path);
  Words words(text, std::string(name) + ": " + path.string());
  const MshFile file = detail::read_msh(words);
  require(!file.tetrahedra.empty(), ErrorKind::Value, words.where(),
          ": expected at least one tetrahedron, got an empty mesh");
  check_volumes(file, words);
  check_manifold(file, words);
  const std::vector<int32_t> rows = kept_rows(file, words, options.drop_loose_vertices);

  TetMesh mesh;
  for (size_t n = 0; n < rows.size(); ++n)
    if (rows[n] >= 0) mesh.vertices.push_back(file.positions[n]);
  mesh.indices.reserve(4 * file.tetrahedra.size());
  for (const auto& tetrahedron : file.tetrahedra)
    for (const int32_t node : tetrahedron.nodes)
      mesh.indices.push_back(rows[static_cast<size_t>(node)]);
  return mesh;
}

}  // namespace novaphy
