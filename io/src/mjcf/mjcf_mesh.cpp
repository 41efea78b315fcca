#include "mjcf_mesh.h"

#include <algorithm>
#include <cstring>

#include "novaphy/core/geometry/hull_of_all.h"
#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kRead[] = {"name",    "class",       "file",        "vertex",
                                      "face",    "scale",       "refpos",      "refquat",
                                      "inertia", "maxhullvert", "content_type"};
// Attributes that only affect rendering, or whose data the reader computes itself.
constexpr std::string_view kPassedOver[] = {"smoothnormal", "texcoord", "normal", "material",
                                            "user"};
constexpr uintmax_t kLargest = uintmax_t{256} << 20;  // bytes

// Reads MuJoCo's binary format: four counts, then positions, normals and texture coordinates as
// float32, and corners as int32.
Mesh read_msh(std::string_view function, const fs::path& path) {
  const std::string bytes = read_file(function, path);
  int32_t counts[4] = {};  // numbers of positions, normals, texture coordinates, triangles
  const bool has_header = bytes.size() >= sizeof counts;
  if (has_header) std::memcpy(counts, bytes.data(), sizeof counts);
  const auto n = [&](int k) { return static_cast<uint64_t>(counts[k]); };
  require(has_header && counts[0] >= 4 && counts[1] >= 0 && counts[2] >= 0 && counts[3] >= 0 &&
              sizeof counts + 12 * (n(0) + n(1) + n(3)) + 8 * n(2) == bytes.size(),
          ErrorKind::Value, path.string(), ": expected a whole .msh file of MuJoCo");
  Mesh mesh;
  mesh.vertices.resize(n(0));
  const char* const at = bytes.data() + sizeof counts;
  std::memcpy(mesh.vertices.data(), at, 12 * n(0));
  mesh.indices.resize(3 * n(3));
  std::memcpy(mesh.indices.data(), at + 12 * (n(0) + n(1)) + 8 * n(2), 12 * n(3));
  for (const Vec3f& v : mesh.vertices)
    require(std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z), ErrorKind::Value,
            path.string(), ": expected finite positions");
  for (const int32_t corner : mesh.indices)
    require(corner >= 0 && corner < counts[0], ErrorKind::Value, path.string(),
            ": expected corners from 0 to ", counts[0] - 1, ", got ", corner);
  return mesh;
}

void drop_degenerate(Mesh& mesh) {
  std::vector<int32_t> kept;
  for (size_t k = 0; k + 2 < mesh.indices.size(); k += 3) {
    const int32_t* const t = &mesh.indices[k];
    const auto at = [&](int c) { return mesh.vertices[static_cast<size_t>(t[c])]; };
    if (at(0) == at(1) || at(1) == at(2) || at(2) == at(0)) continue;
    kept.insert(kept.end(), t, t + 3);
  }
  mesh.indices = std::move(kept);
}

}  // namespace

MjcfAssets::MjcfAssets(const XmlFile& file, const MjcfDefaults& defaults,
                       const MjcfSettings& settings, std::span<const fs::path> package_dirs,
                       Notes& notes)
    : file_(file), defaults_(defaults), compiler_(settings.compiler), package_dirs_(package_dirs) {
  for (const Element* assets = file.root().FirstChildElement("asset"); assets != nullptr;
       assets = assets->NextSiblingElement("asset"))
    for (const Element* e = assets->FirstChildElement(); e != nullptr;
         e = e->NextSiblingElement()) {
      const std::string_view kind = e->Name();
      const char* const name = e->Attribute("name");
      if (kind == "material") {
        double c[4];
        if (name != nullptr && defaults.numbers(*e, "rgba", {}, c))
          colors_[name] = {static_cast<float>(c[0]), static_cast<float>(c[1]),
                           static_cast<float>(c[2]), static_cast<float>(c[3])};
      } else if (kind == "mesh") {
        const std::string given = defaults.text(*e, "file", {}).value_or("");
        const std::string own = name != nullptr ? name : fs::path(given).stem().string();
        if (own.empty()) file.refuse(*e, "name: expected a name or a file, got none");
        if (!meshes_.emplace(own, Asset{e, given}).second)
          file.refuse(*e, "name: expected different names, got \"" + own + "\" twice");
        notes.read("mesh");
      } else if (kind != "texture" && kind != "hfield" && kind != "skin" && kind != "model") {
        file.refuse(*e, "this element is not read", ErrorKind::NotImplemented);
      }
    }
}

std::optional<Vec4f> MjcfAssets::color(const std::string& material) const {
  const auto found = colors_.find(material);
  return found == colors_.end() ? std::nullopt : std::optional(found->second);
}

std::string MjcfAssets::path_of(const std::string& file) const {
  const fs::path path = compiler_.strip_path ? fs::path(file).filename() : fs::path(file);
  return path.is_absolute() ? path.string() : (compiler_.mesh_folder / path).string();
}

bool MjcfAssets::is_there(const std::string& name) const {
  const auto found = meshes_.find(name);
  if (found == meshes_.end() || found->second.file.empty()) return true;
  try {
    file_.resolve(*found->second.element, path_of(found->second.file), found->second.file,
                  package_dirs_);
    return true;
  } catch (const Error&) {
    return false;
  }
}

const MjcfMesh& MjcfAssets::mesh(const Element& user, const std::string& name) {
  const auto found = meshes_.find(name);
  if (found == meshes_.end()) file_.refuse(user, "mesh: there is no mesh \"" + name + "\"");
  Asset& asset = found->second;
  if (asset.mesh == nullptr) asset.mesh = std::make_unique<MjcfMesh>(load(asset));
  return *asset.mesh;
}

MjcfMesh MjcfAssets::load(const Asset& asset) {
  const Element& e = *asset.element;
  defaults_.check_known(e, {}, kRead, kPassedOver);
  MjcfMesh result;
  const std::string how = defaults_.text(e, "inertia", {}).value_or("legacy");
  if (how != "legacy" && how != "exact" && how != "convex" && how != "shell")
    file_.refuse(e, "inertia: expected legacy, exact, convex or shell, got \"" + how + "\"");
  result.inertia = how == "exact"    ? MeshInertia::Exact
                   : how == "convex" ? MeshInertia::Convex
                   : how == "shell"  ? MeshInertia::Shell
                                     : MeshInertia::Legacy;
  const double most = defaults_.number(e, "maxhullvert", {}, -1.0);
  if (most > 3.0)
    result.hull_vertices = static_cast<int32_t>(std::min(most, 1.0 * kMaxHullVertices));

  Mesh mesh;
  try {
    if (asset.file.empty()) {
      const std::vector<double> v = defaults_.list(e, "vertex", {});
      if (v.empty() || v.size() % 3 != 0) file_.refuse(e, "expected a file, or 3 numbers a vertex");
      for (size_t k = 0; k < v.size(); k += 3)
        mesh.vertices.push_back(to_float(Vec3d{v[k], v[k + 1], v[k + 2]}));
      for (const double corner : defaults_.list(e, "face", {})) {
        if (corner < 0.0 || corner != std::floor(corner) ||
            3.0 * corner >= static_cast<double>(v.size()))
          file_.refuse(e, "face: expected numbers of vertices");
        mesh.indices.push_back(static_cast<int32_t>(corner));
      }
      if (mesh.indices.size() % 3 != 0) file_.refuse(e, "face: expected 3 numbers a triangle");
      if (mesh.indices.empty()) mesh.indices = hull_of_all(mesh.vertices);
    } else {
      const fs::path path = file_.resolve(e, path_of(asset.file), asset.file, package_dirs_);
      std::error_code error;
      if (fs::file_size(path, error) > kLargest || error)
        file_.refuse(e, "expected a file of at most 256 MiB, got " + path.string());
      mesh = path.extension() == ".msh" || path.extension() == ".MSH"
                 ? read_msh(file_.function(), path)
                 : load_mesh(path, {.drop_degenerate = true});
    }
  } catch (const Error& error) {
    if (std::string_view(error.what()).starts_with(std::string(file_.function()) + ": ")) throw;
    file_.refuse(e, error.what(), error.kind());
  }

  // Moves refpos to the origin, removes the rotation refquat, then applies the scale.
  double place[3] = {0.0, 0.0, 0.0}, q[4] = {1.0, 0.0, 0.0, 0.0}, scale[3] = {1.0, 1.0, 1.0};
  defaults_.numbers(e, "refpos", {}, place);
  defaults_.numbers(e, "refquat", {}, q);
  defaults_.numbers(e, "scale", {}, scale);
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  if (!(norm > 1e-10)) file_.refuse(e, "refquat: expected numbers that are not all zero");
  if (scale[0] == 0.0 || scale[1] == 0.0 || scale[2] == 0.0)
    file_.refuse(e, "scale: expected numbers that are not 0");
  const Quatd back = {-q[1] / norm, -q[2] / norm, -q[3] / norm, q[0] / norm};
  for (Vec3f& v : mesh.vertices) {
    const Vec3d at = math::rotate(back, Vec3d{v.x - place[0], v.y - place[1], v.z - place[2]});
    v = to_float(Vec3d{at.x * scale[0], at.y * scale[1], at.z * scale[2]});
  }
  if (scale[0] * scale[1] * scale[2] < 0.0)  // a mirrored mesh: flip the orientation of triangles
    for (size_t k = 0; k + 2 < mesh.indices.size(); k += 3)
      std::swap(mesh.indices[k + 1], mesh.indices[k + 2]);
  drop_degenerate(mesh);
  if (mesh.indices.empty()) file_.refuse(e, "expected a triangle, got none");
  result.surface = std::make_shared<const Mesh>(std::move(mesh));
  return result;
}

}  // namespace novaphy::detail
