// The meshes and materials in the <asset> sections of MJCF files.
#pragma once

#include <map>
#include <memory>

#include "mjcf_defaults.h"
#include "mjcf_mass.h"

namespace novaphy::detail {

struct MjcfMesh {
  std::shared_ptr<const Mesh> surface;
  MeshInertia inertia = MeshInertia::Legacy;
  int32_t hull_vertices = kMaxHullVertices;
  SolidMass mass(bool is_shell) const {
    return mesh_mass(*surface, is_shell ? MeshInertia::Shell : inertia);
  }
};

class MjcfAssets {
 public:
  // Reads the names of meshes and materials. The file of a mesh is read when the mesh is first
  // used.
  MjcfAssets(const XmlFile& file, const MjcfDefaults& defaults, const MjcfSettings& settings,
             std::span<const std::filesystem::path> package_dirs, Notes& notes);

  // Returns the mesh that an element uses. ErrorKind::Value: the name does not exist, or the file
  // of the mesh is refused.
  const MjcfMesh& mesh(const Element& user, const std::string& name);
  // Returns whether the file of a mesh exists. A mesh without a file counts as existing.
  bool is_there(const std::string& name) const;
  std::optional<Vec4f> color(const std::string& material) const;

 private:
  struct Asset {
    const Element* element;
    std::string file;  // empty: the vertices are in the MJCF file
    std::unique_ptr<MjcfMesh> mesh = {};
  };
  std::string path_of(const std::string& file) const;
  MjcfMesh load(const Asset& asset);

  const XmlFile& file_;
  const MjcfDefaults& defaults_;
  const MjcfCompiler& compiler_;
  const std::span<const std::filesystem::path> package_dirs_;
  std::map<std::string, Asset> meshes_;
  std::map<std::string, Vec4f> colors_;
};

}  // namespace novaphy::detail
