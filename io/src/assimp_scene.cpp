#include "assimp_scene.h"

#include <assimp/BaseImporter.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/math/functions.h"

namespace novaphy::detail {
namespace {

// Removes all importers but the importer of the extension, so that assimp does not guess the format
// from the contents.
void keep_one_importer(Assimp::Importer& importer, std::string_view extension) {
  const Assimp::BaseImporter* const wanted = importer.GetImporter(std::string(extension).c_str());
  for (size_t n = importer.GetImporterCount(); n-- > 0;) {
    Assimp::BaseImporter* const other = importer.GetImporter(n);
    if (other == wanted) continue;
    importer.UnregisterLoader(other);
    delete other;  // unregistering passes the ownership to the caller
  }
}

// Checks the indices of polygon corners, because the triangulation does not. assimp's own
// validation would also refuse files for their cameras, lights, materials, bones and animations.
void check_faces(const std::string& where, const aiScene& scene) {
  constexpr unsigned kMostCorners = AI_MAX_FACE_INDICES;
  for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
    const aiMesh& mesh = *scene.mMeshes[m];
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
      const aiFace& face = mesh.mFaces[f];
      const auto check = [&](bool good, const auto&... expected) {
        require(good, ErrorKind::Value, where, ": mesh ", m, ", face ", f, ": expected ",
                expected...);
      };
      check(face.mNumIndices > 0 && face.mNumIndices <= kMostCorners, "1 to ", kMostCorners,
            " corners, got ", face.mNumIndices);
      for (unsigned c = 0; c < face.mNumIndices; ++c)
        check(face.mIndices[c] < mesh.mNumVertices, "corners from 0 to ",
              int64_t{mesh.mNumVertices} - 1, ", got ", face.mIndices[c],
              ", which is out of range");
    }
  }
}

Vec3f to_vec3(const aiVector3D& v) { return {v.x, v.y, v.z}; }

// Returns the color of a material. Returns nothing for a material with an image, and for assimp's
// default material.
std::optional<Vec3f> color_of(const aiMaterial& material, const Colors* colors) {
  aiString name;
  const bool has_name = material.Get(AI_MATKEY_NAME, name) == AI_SUCCESS;
  if (has_name && std::string_view(name.C_Str()) == AI_DEFAULT_MATERIAL_NAME) return std::nullopt;
  if (colors != nullptr) {
    const auto known = colors->find(name.C_Str());
    return known == colors->end() ? std::nullopt : std::optional(known->second);
  }
  aiColor3D color;
  if (material.GetTextureCount(aiTextureType_DIFFUSE) > 0 ||
      material.Get(AI_MATKEY_COLOR_DIFFUSE, color) != AI_SUCCESS)
    return std::nullopt;
  return Vec3f{color.r, color.g, color.b};
}

void append_mesh(const aiMesh& mesh, const aiMatrix4x4& to_world, const std::optional<Vec3f>& color,
                 Soup& out) {
  const bool mirrored = to_world.Determinant() < 0;
  for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
    const aiFace& face = mesh.mFaces[f];
    if (face.mNumIndices != 3) continue;  // points and lines are skipped
    Triangle triangle;
    for (size_t corner = 0; corner < 3; ++corner)
      triangle[corner] = to_vec3(to_world * mesh.mVertices[face.mIndices[corner]]);
    if (mirrored) std::swap(triangle[1], triangle[2]);
    out.add(triangle, color);
  }
}

void append_node(const aiScene& scene, const aiNode& node, const aiMatrix4x4& parent,
                 const std::vector<std::optional<Vec3f>>& colors, Soup& out) {
  const aiMatrix4x4 to_world = parent * node.mTransformation;
  for (unsigned m = 0; m < node.mNumMeshes; ++m) {
    const aiMesh& mesh = *scene.mMeshes[node.mMeshes[m]];
    const bool has_color = mesh.mMaterialIndex < colors.size();
    append_mesh(mesh, to_world, has_color ? colors[mesh.mMaterialIndex] : std::nullopt, out);
  }
  for (unsigned c = 0; c < node.mNumChildren; ++c)
    append_node(scene, *node.mChildren[c], to_world, colors, out);
}

}  // namespace

void Soup::add(const Triangle& triangle, const std::optional<Vec3f>& color) {
  triangles.push_back(triangle);
  const bool is_finite = color && std::isfinite(color->x + color->y + color->z);
  colors.push_back(is_finite ? color : std::nullopt);
}

Soup read_triangles(const std::string& where, std::string_view bytes, std::string_view extension,
                    const Colors* colors) {
  Assimp::Importer importer;
  keep_one_importer(importer, extension);
  const std::string hint(extension.substr(1));
  const aiScene* scene = importer.ReadFileFromMemory(bytes.data(), bytes.size(), 0, hint.c_str());
  const auto check_read = [&] {
    require(scene != nullptr && scene->mRootNode != nullptr, ErrorKind::Value, where,
            ": expected a whole ", extension, " file; assimp says: ", importer.GetErrorString());
  };
  check_read();
  check_faces(where, *scene);
  scene = importer.ApplyPostProcessing(aiProcess_Triangulate);
  check_read();
  // The rotation from y up to z up: assimp converts COLLADA to y up, and NovaPhy uses z up.
  aiMatrix4x4 to_z_up;
  if (extension == ".dae") to_z_up = aiMatrix4x4(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1);
  std::vector<std::optional<Vec3f>> of_materials;
  if (extension == ".dae" || extension == ".obj")
    for (unsigned m = 0; m < scene->mNumMaterials; ++m)
      of_materials.push_back(color_of(*scene->mMaterials[m], colors));
  Soup soup;
  append_node(*scene, *scene->mRootNode, to_z_up, of_materials, soup);
  return soup;
}

}  // namespace novaphy::detail
