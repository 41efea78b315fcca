// The scenes of Newton 1.8.0's SolverVBD (cpu). newton_vbd_cloth.npz is a cloth of 16 x 16
// particles with one fixed corner, falling on a sphere, a box and the ground. newton_vbd_soft.npz
// is a block of 5 x 5 x 5 particles with four springs, falling on a box and the ground. The files
// have Newton's model, and the contacts of every substep from the positions before the substep. The
// files also have positions at sub_idx, the iterates of three substeps, and forces and Hessians of
// single elements (unit_*).
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/vbd/solver_vbd.h"
#include "support/npz.h"

namespace novaphy::testing {

class NewtonVbdScene {
 public:
  explicit NewtonVbdScene(const char* file_name) : file(golden(file_name)) {
    ModelBuilder b(Axis::Z, file["model_gravity"].as<Vec3f>()[0]);
    b.add_particles(column<Vec3f>("particle_q"), column<Vec3f>("particle_qd"),
                    column<float>("particle_mass"), column<float>("particle_radius"),
                    column<int32_t>("particle_flags"));
    if (file.contains("model_spring_indices")) {
      const auto ends = column<Vec2i>("spring_indices");
      for (size_t e = 0; e < ends.size(); ++e)
        b.add_spring(ends[e].x, ends[e].y, column<float>("spring_stiffness")[e],
                     column<float>("spring_damping")[e]);
    }
    b.add_triangles(column<Vec3i>("tri_indices"));
    b.add_edges(column<Vec4i>("edge_indices"));
    if (file.contains("model_tet_indices")) b.add_tetrahedra(column<Vec4i>("tet_indices"));
    add_shapes(b);
    b.set_coloring(groups(), true);
    model = b.finalize(Device::cpu());
    copy("spring_rest_length", model->particle_spring_rest_length);
    copy("tri_poses", model->particle_tri_pose);
    copy("tri_areas", model->particle_tri_area);
    copy("tri_materials", model->particle_tri_material);
    copy("edge_rest_angle", model->particle_edge_rest_angle);
    copy("edge_rest_length", model->particle_edge_rest_length);
    copy("edge_bending_properties", model->particle_edge_material);
    copy("tet_poses", model->particle_tet_pose);
    copy("tet_materials", model->particle_tet_material);
    model->soft_contact_ke = file["model_soft_contact_ke"].scalar<float>();
    model->soft_contact_kd = file["model_soft_contact_kd"].scalar<float>();
    model->soft_contact_mu = file["model_soft_contact_mu"].scalar<float>();
  }

  size_t particles() const { return static_cast<size_t>(model->particle_count()); }
  float dt() const { return file["dt"].scalar<float>(); }
  int32_t iterations() const { return file["iterations"].scalar<int32_t>(); }

  // Newton's colors, ids ascending.
  std::vector<std::vector<int32_t>> groups() const {
    const auto ids = file["color_group_ids"].as<int32_t>();
    const auto offsets = file["color_group_offsets"].as<int32_t>();
    std::vector<std::vector<int32_t>> result;
    for (size_t c = 0; c + 1 < offsets.size(); ++c)
      result.emplace_back(ids.begin() + offsets[c], ids.begin() + offsets[c + 1]);
    return result;
  }

  // The contacts of a substep.
  Contacts contacts(size_t substep) const {
    const auto counts = file["contact_count"].as<int32_t>();
    size_t first = 0;
    for (size_t t = 0; t < substep; ++t) first += static_cast<size_t>(counts[t]);
    const auto count = static_cast<size_t>(counts[substep]);
    Contacts contacts({.soft_contact_max = counts[substep], .model_id = model->id()},
                      Device::cpu());
    contacts.soft_contact_count.fill(counts[substep]);
    contacts.soft_contact_particle.copy_from_host(
        file["contact_particle"].as<int32_t>().subspan(first, count));
    contacts.soft_contact_shape.copy_from_host(
        file["contact_shape"].as<int32_t>().subspan(first, count));
    contacts.soft_contact_body_pos.copy_from_host(
        file["contact_body_pos"].as<Vec3f>().subspan(first, count));
    contacts.soft_contact_normal.copy_from_host(
        file["contact_normal"].as<Vec3f>().subspan(first, count));
    return contacts;
  }

  // Returns Newton's positions after `substeps` substeps; empty if the file does not have them.
  std::span<const Vec3f> q(size_t substeps) const {
    const auto kept = file["sub_idx"].as<int32_t>();
    const auto found = std::find(kept.begin(), kept.end(), static_cast<int32_t>(substeps));
    if (found == kept.end()) return {};
    return file["q"].as<Vec3f>().subspan(static_cast<size_t>(found - kept.begin()) * particles(),
                                         particles());
  }

  const Npz file;
  std::shared_ptr<Model> model;

 private:
  template <class T>
  std::span<const T> column(const char* name) const {
    return file["model_" + std::string(name)].as<T>();
  }
  void copy(const char* name, Array& array) const {
    const std::string key = "model_" + std::string(name);
    if (!file.contains(key)) return;
    const NpyArray& values = file[key];
    array.copy_from_host(values.bytes.data(), values.bytes.size());
  }
  void add_shapes(ModelBuilder& b) const {
    for (size_t s = 0; s < column<int32_t>("shape_type").size(); ++s) {
      const ShapeConfig cfg = {.ke = column<float>("shape_material_ke")[s],
                               .kd = column<float>("shape_material_kd")[s],
                               .mu = column<float>("shape_material_mu")[s],
                               .margin = column<float>("shape_margin")[s]};
      b.add_shape({.body = -1,
                   .type = static_cast<GeoType>(column<int32_t>("shape_type")[s]),
                   .xform = column<Transformf>("shape_transform")[s],
                   .scale = column<Vec3f>("shape_scale")[s],
                   .cfg = cfg});
    }
  }
};

inline float largest_distance(std::span<const Vec3f> a, std::span<const Vec3f> b) {
  float largest = 0.0f;
  for (size_t i = 0; i < a.size(); ++i) largest = std::max(largest, math::length(a[i] - b[i]));
  return largest;
}

}  // namespace novaphy::testing
