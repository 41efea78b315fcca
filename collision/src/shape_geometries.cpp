#include "shape_geometries.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <span>
#include <string>
#include <tuple>
#include <utility>

#include "novaphy/collision/mesh_tree.h"
#include "novaphy/core/error.h"
#include "novaphy/core/geometry/convex_hull.h"
#include "novaphy/core/recorder.h"

namespace novaphy::detail {
namespace {

using geometry::GeometryView;

// Writes the views and then their tables into one block of bytes. The pointers in the views refer
// to the final address of the block.
class TableWriter {
 public:
  explicit TableWriter(size_t views) : bytes_(round_up(views * sizeof(GeometryView))) {}

  // Reserves memory for tables that will be added.
  template <class... T>
  void expect(const std::vector<T>&... tables) {
    const size_t bytes = bytes_.size() + (... + round_up(tables.size() * sizeof(T) + 1));
    if (bytes > bytes_.capacity()) bytes_.reserve(std::max(bytes, 2 * bytes_.capacity()));
  }
  // Appends a table. The returned pointer is an offset until move_to() converts it.
  template <class T>
  const T* add(const std::vector<T>& table) {
    const size_t at = bytes_.size();
    bytes_.resize(round_up(at + std::max<size_t>(table.size() * sizeof(T), 1)));
    if (!table.empty()) std::memcpy(&bytes_[at], table.data(), table.size() * sizeof(T));
    return reinterpret_cast<const T*>(at);
  }
  std::shared_ptr<Storage> upload(std::vector<GeometryView> views, Device device) {
    auto storage = Storage::allocate(bytes_.size(), device);
    const auto base = reinterpret_cast<uintptr_t>(storage->data());
    const auto move = [base](auto*& table) {
      if (table == nullptr) return;  // offset 0 means no table
      table = reinterpret_cast<std::remove_reference_t<decltype(table)>>(
          base + reinterpret_cast<uintptr_t>(table));
    };
    for (GeometryView& view : views) {
      geometry::HullView& h = view.hull;
      move(h.vertices), move(h.face_normals), move(h.face_starts), move(h.face_vertices);
      move(h.neighbor_starts), move(h.neighbors);
      geometry::MeshView& m = view.mesh;
      move(m.vertices), move(m.triangles), move(m.normals), move(m.ring_starts), move(m.ring);
      move(m.edges), move(m.own_edges), move(m.across), move(m.nodes), move(m.order);
    }
    if (!views.empty()) std::memcpy(bytes_.data(), views.data(), views.size() * sizeof(views[0]));
    Array(DType::uint8, bytes_.size(), 1, storage->range())
        .copy_from_host(bytes_.data(), bytes_.size());
    return storage;
  }

 private:
  static size_t round_up(size_t bytes) { return (bytes + 15) / 16 * 16; }
  std::vector<std::byte> bytes_;
};

geometry::Box3 box_of(const std::vector<Vec3f>& vertices) {
  geometry::Box3 box{vertices[0], vertices[0]};
  for (const Vec3f& v : vertices) {
    box.lo = {std::min(box.lo.x, v.x), std::min(box.lo.y, v.y), std::min(box.lo.z, v.z)};
    box.hi = {std::max(box.hi.x, v.x), std::max(box.hi.y, v.y), std::max(box.hi.z, v.z)};
  }
  return box;
}

GeometryView add_hull(TableWriter& writer, const std::vector<Vec3f>& vertices) {
  const ConvexHull hull = convex_hull(vertices);
  GeometryView view;
  view.hull.vertices = writer.add(hull.vertices);
  view.hull.face_normals = writer.add(hull.face_normals);
  view.hull.face_starts = writer.add(hull.face_starts);
  view.hull.face_vertices = writer.add(hull.face_vertices);
  view.hull.neighbor_starts = writer.add(hull.neighbor_starts);
  view.hull.neighbors = writer.add(hull.neighbors);
  view.hull.vertex_count = static_cast<int32_t>(hull.vertices.size());
  view.hull.face_count = static_cast<int32_t>(hull.face_normals.size());
  view.box = box_of(hull.vertices);
  return view;
}

GeometryView add_mesh(TableWriter& writer, const std::vector<Vec3f>& vertices,
                      std::span<const Vec3i> triangles) {
  const MeshTree tree = build_mesh_tree(vertices, {&triangles[0].x, 3 * triangles.size()});
  GeometryView view;
  writer.expect(tree.vertices, tree.triangles, tree.normals, tree.ring_starts, tree.ring,
                tree.edges, tree.own_edges, tree.across, tree.nodes, tree.order);
  view.mesh = mesh_view(tree);
  view.mesh.vertices = writer.add(tree.vertices);
  view.mesh.triangles = writer.add(tree.triangles);
  view.mesh.normals = writer.add(tree.normals);
  view.mesh.ring_starts = writer.add(tree.ring_starts);
  view.mesh.ring = writer.add(tree.ring);
  view.mesh.edges = writer.add(tree.edges);
  view.mesh.own_edges = writer.add(tree.own_edges);
  view.mesh.across = writer.add(tree.across);
  view.mesh.nodes = writer.add(tree.nodes);
  view.mesh.order = writer.add(tree.order);
  view.box = tree.nodes[0].box;
  return view;
}

}  // namespace

std::array<const Array*, 5> ShapeGeometries::sources() const {
  const Model& m = *model_;
  return {&m.shape_type, &m.shape_scale, &m.shape_mesh_range, &m.mesh_vertices, &m.mesh_indices};
}

void ShapeGeometries::update() {
  depend_on(sources());
  if (versions_.match(sources())) return;
  versions_.reset();
  const Model& m = *model_;
  const std::vector<int32_t> type = m.shape_type.to_host(), ranges = m.shape_mesh_range.to_host();
  const std::vector<Vec3f> scale = m.shape_scale.to_host(), vertices = m.mesh_vertices.to_host();
  const std::vector<Vec3i> triangles = m.mesh_indices.to_host();

  // Groups shapes with the same geometry, in the order of their first occurrence.
  using Key = std::tuple<int32_t, int32_t, int32_t, float, float, float>;
  std::map<Key, int32_t> found;
  std::vector<size_t> first;
  std::vector<int32_t> of_shape(type.size(), -1);
  for (size_t s = 0; s < type.size(); ++s) {
    const auto shape_type = static_cast<GeoType>(type[s]);
    if (shape_type != GeoType::MESH && shape_type != GeoType::CONVEX_MESH) continue;
    const int32_t* range = &ranges[4 * s];
    const auto inside = [](int32_t begin, int32_t count, size_t size) {
      return begin >= 0 && count > 0 &&
             static_cast<size_t>(begin) + static_cast<size_t>(count) <= size;
    };
    require(
        inside(range[0], range[1], vertices.size()) && inside(range[2], range[3], triangles.size()),
        ErrorKind::Value, "CollisionPipeline: model.shape_mesh_range[", s,
        "]: expected rows of mesh_vertices (", vertices.size(), ") and mesh_indices (",
        triangles.size(), "), got (", range[0], ", ", range[1], ", ", range[2], ", ", range[3],
        ")");
    const Key key{type[s], range[0], range[2], scale[s].x, scale[s].y, scale[s].z};
    const auto [at, is_new] = found.try_emplace(key, static_cast<int32_t>(first.size()));
    if (is_new) first.push_back(s);
    of_shape[s] = at->second;
  }

  TableWriter writer(first.size());
  std::vector<GeometryView> views;
  for (const size_t s : first) {
    const int32_t* range = &ranges[4 * s];
    std::vector<Vec3f> scaled;
    scaled.reserve(static_cast<size_t>(range[1]));
    for (int32_t k = range[0]; k < range[0] + range[1]; ++k) {
      const Vec3f& v = vertices[static_cast<size_t>(k)];
      scaled.push_back({v.x * scale[s].x, v.y * scale[s].y, v.z * scale[s].z});
    }
    const std::span<const Vec3i> faces(&triangles[static_cast<size_t>(range[2])],
                                       static_cast<size_t>(range[3]));
    try {
      views.push_back(static_cast<GeoType>(type[s]) == GeoType::MESH
                          ? add_mesh(writer, scaled, faces)
                          : add_hull(writer, scaled));
    } catch (const Error& e) {
      fail(e.kind(), "CollisionPipeline: shape ", s, ": ", e.what());
    }
  }
  tables_ = writer.upload(std::move(views), m.device());
  of_shape_ = DeviceArray<int32_t>::from_host(of_shape, m.device());
  versions_.set(sources());
  ++version_;
}

}  // namespace novaphy::detail
