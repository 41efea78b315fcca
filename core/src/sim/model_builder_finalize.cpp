#include <algorithm>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

template <class T>
void upload(DeviceArray<T>& array, const std::vector<T>& values) {
  array.copy_from_host(std::span<const T>(values));
}

}  // namespace

void ModelBuilder::upload_elements(Model& m) const {
  upload(m.particle_spring_indices, springs_.indices);
  upload(m.particle_spring_rest_length, springs_.rest_length);
  upload(m.particle_spring_stiffness, springs_.stiffness);
  upload(m.particle_spring_damping, springs_.damping);
  upload(m.particle_spring_control, springs_.control);
  upload(m.particle_spring_tension_only, springs_.tension_only);
  upload(m.particle_tri_indices, triangles_.indices);
  upload(m.particle_tri_pose, triangles_.pose);
  upload(m.particle_tri_area, triangles_.area);
  upload(m.particle_tri_material, triangles_.material);
  upload(m.particle_edge_indices, edges_.indices);
  upload(m.particle_edge_rest_angle, edges_.rest_angle);
  upload(m.particle_edge_rest_length, edges_.rest_length);
  upload(m.particle_edge_material, edges_.material);
  upload(m.particle_tet_indices, tetrahedra_.indices);
  upload(m.particle_tet_pose, tetrahedra_.pose);
  upload(m.particle_tet_volume, tetrahedra_.volume);
  upload(m.particle_tet_material, tetrahedra_.material);
  upload(m.particle_tet_is_lame, tetrahedra_.is_lame);
}

template <class Shapes>
void upload_materials(const Shapes& shapes, Model& m) {
  const auto of = [&](auto& array, float ShapeConfig::*number) {
    std::vector<float> values;
    for (const auto& s : shapes) values.push_back(s.cfg.*number);
    upload(array, values);
  };
  of(m.shape_material_ke, &ShapeConfig::ke);
  of(m.shape_material_kd, &ShapeConfig::kd);
  of(m.shape_material_kf, &ShapeConfig::kf);
  of(m.shape_material_ka, &ShapeConfig::ka);
  of(m.shape_material_mu, &ShapeConfig::mu);
  of(m.shape_material_restitution, &ShapeConfig::restitution);
  of(m.shape_material_mu_torsional, &ShapeConfig::mu_torsional);
  of(m.shape_material_mu_rolling, &ShapeConfig::mu_rolling);
  std::vector<float> mixing;
  for (const auto& s : shapes)
    for (const float x :
         {s.cfg.mixing.priority, s.cfg.mixing.weight, s.cfg.mixing.inverse_mass, s.cfg.mixing.mu})
      mixing.push_back(x);
  upload(m.shape_mixing, mixing);
}

namespace {

void check_refused(const std::vector<std::string>& refused) {
  if (refused.empty()) return;
  const std::string more = " (and " + std::to_string(refused.size() - 1) + " more)";
  fail(ErrorKind::NotImplemented, "finalize: ", refused.front(), refused.size() < 2 ? "" : more);
}

}  // namespace

std::shared_ptr<Model> ModelBuilder::finalize(Device device, const FinalizeOptions& options) const {
  require_device(device);
  require(current_world_ < 0, ErrorKind::Runtime, "finalize: world ", current_world_,
          " is open; call end_world() first");
  check_sizes();
  check_refused(refused_);
  if (!options.skip_validation) {
    check_values();
    check_coloring("finalize");
  }
  BodyMasses masses = body_masses();
  if (!options.skip_validation) {
    mend_bodies(masses);
    check_bodies(masses);
    check_joints();
  }

  const size_t shapes = shapes_.size();
  const auto column = [&](auto get) {  // returns a property of all shapes, one row per shape
    std::vector<decltype(get(shapes_[0]))> values(shapes);
    std::transform(shapes_.begin(), shapes_.end(), values.begin(), get);
    return values;
  };
  const auto paired = std::make_shared<const ShapePairList::Columns>(ShapePairList::Columns{
      .body = column([](const Shape& s) { return s.body; }),
      .flags = column([](const Shape& s) { return s.cfg.flags(); }),
      .collision_group = column([](const Shape& s) { return s.cfg.collision_group; }),
      .world = column([](const Shape& s) { return s.world; })});

  const MeshPool meshes = mesh_pool();
  ModelCounts counts;
  counts.mesh_vertex_count = static_cast<int32_t>(meshes.vertices.size());
  counts.mesh_triangle_count = static_cast<int32_t>(meshes.triangles.size());
  counts.particle_count = particle_count();
  counts.body_count = body_count();
  counts.shape_count = shape_count();
  counts.joint_count = joint_count();
  counts.joint_coord_count = joint_coord_count();
  counts.joint_dof_count = joint_dof_count();
  counts.articulation_count = articulation_count();
  counts.actuator_count = actuator_count();
  counts.actuator_state_count = actuators_.state_count();
  counts.spring_count = spring_count();
  counts.tri_count = tri_count();
  counts.edge_count = edge_count();
  counts.tet_count = tet_count();
  counts.world_count = std::max(world_count(), 1);
  std::shared_ptr<Model> model(new Model(counts, device, up_axis_));
  Model& m = *model;
  m.allocate(counts, device);
  m.requires_grad = options.requires_grad;

  upload(m.particle_q, particle_q);
  upload(m.particle_qd, particle_qd);
  upload(m.particle_mass, particle_mass);
  upload(m.particle_radius, particle_radius);
  upload(m.particle_flags, particle_flags);
  upload(m.particle_world, particle_world);
  std::vector<int32_t> colors = colors_;
  colors.resize(particle_q.size(), -1);
  upload(m.particle_colors, colors);
  for (const float radius : particle_radius)
    m.particle_max_radius = std::max(m.particle_max_radius, radius);

  upload_elements(m);
  upload_bodies(m, masses);
  upload_joints(m);
  actuators_.upload(m);
  m.shape_pair_list().follow(paired);
  upload(m.shape_body, paired->body);
  upload(m.shape_flags, paired->flags);
  upload(m.shape_collision_group, paired->collision_group);
  upload(m.shape_world, paired->world);
  upload(m.shape_color, column([](const Shape& s) {
           return s.cfg.color.value_or(Vec3f{-1.0f, -1.0f, -1.0f});
         }));
  upload(m.shape_transform, column([](const Shape& s) { return s.xform; }));
  upload(m.shape_type, column([](const Shape& s) { return static_cast<int32_t>(s.type); }));
  upload(m.shape_scale, column([](const Shape& s) { return s.scale; }));
  upload(m.shape_mesh_range, meshes.ranges);
  upload(m.mesh_vertices, meshes.vertices);
  upload(m.mesh_indices, meshes.triangles);
  upload(m.shape_is_solid,
         column([](const Shape& s) { return static_cast<uint8_t>(s.cfg.is_solid); }));
  upload(m.shape_margin, column([](const Shape& s) { return s.cfg.margin; }));
  upload(m.shape_gap, column([](const Shape& s) { return s.gap; }));
  upload_materials(shapes_, m);
  const auto bounds = column([](const Shape& s) {
    return s.mesh ? detail::mesh_bounds(s.mesh->vertices, s.scale)
                  : detail::shape_bounds(s.type, s.scale);
  });
  std::vector<float> radius(shapes);
  std::vector<Vec3f> lower(shapes), upper(shapes);
  for (size_t i = 0; i < shapes; ++i) {
    radius[i] = bounds[i].radius;
    lower[i] = bounds[i].lower;
    upper[i] = bounds[i].upper;
  }
  upload(m.shape_collision_radius, radius);
  upload(m.shape_aabb_lower, lower);
  upload(m.shape_aabb_upper, upper);
  m.shape_label = column([](const Shape& s) { return s.label; });
  m.shape_collision_filter_pairs = all_filter_pairs();

  if (world_gravity_.empty()) {
    m.gravity.fill(gravity);
  } else {
    upload(m.gravity, world_gravity_);
  }
  m.update_derived();
  m.keep_structure();
  return model;
}

}  // namespace novaphy
