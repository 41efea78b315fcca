#include "novaphy/core/sim/model_builder.h"

#include <algorithm>
#include <limits>

#include "builder_checks.h"
#include "novaphy/core/error.h"

namespace novaphy {
namespace {

using detail::Where;

constexpr size_t kMaxCount = static_cast<size_t>(std::numeric_limits<int32_t>::max());

Vec3f gravity_vector(Axis up_axis, const GravitySpec& gravity) {
  if (!gravity.along_up) return gravity.vector;
  return axis_vector(up_axis) * *gravity.along_up;
}

void check_one_length(std::string_view function, std::string_view argument, size_t size,
                      size_t expected, bool may_be_empty) {
  require(size == expected || (may_be_empty && size == 0), ErrorKind::Value, function, ": ",
          argument, ": expected ", expected, " elements as pos has",
          may_be_empty ? " (or none)" : "", ", got ", size);
}

// The number of a shape that is about to be added to the world.
void check_body(std::string_view function, int32_t body) {
  require(body == -1, ErrorKind::Index, function,
          ": body: expected -1 (the world; body_count is 0), got ", body,
          ", which is out of range");
}

}  // namespace

ModelBuilder::ModelBuilder(Axis up_axis, const GravitySpec& gravity_spec) : up_axis_(up_axis) {
  require(up_axis == Axis::X || up_axis == Axis::Y || up_axis == Axis::Z, ErrorKind::Value,
          "ModelBuilder: up_axis: expected X, Y or Z, got ", static_cast<int32_t>(up_axis));
  gravity = gravity_vector(up_axis, gravity_spec);
  detail::check_finite({"ModelBuilder", "gravity"}, gravity);
}

int32_t ModelBuilder::add_particle(const Vec3f& pos, const Vec3f& vel, float mass,
                                   std::optional<float> radius, int32_t flags) {
  constexpr std::string_view name = "add_particle";
  const float r = radius.value_or(default_particle_radius);
  detail::check_finite({name, "pos"}, pos);
  detail::check_finite({name, "vel"}, vel);
  detail::check_mass({name, "mass"}, mass);
  detail::check_not_negative({name, radius ? "radius" : "default_particle_radius"}, r);
  detail::check_particle_flags({name, "flags"}, flags);
  require(particle_q.size() < kMaxCount, ErrorKind::Value, name, ": expected at most ", kMaxCount,
          " particles");
  particle_q.push_back(pos);
  particle_qd.push_back(vel);
  particle_mass.push_back(mass);
  particle_radius.push_back(r);
  particle_flags.push_back(flags);
  particle_world.push_back(current_world_);
  return particle_count() - 1;
}

void ModelBuilder::add_particles(std::span<const Vec3f> pos, std::span<const Vec3f> vel,
                                 std::span<const float> mass, std::span<const float> radius,
                                 std::span<const int32_t> flags) {
  constexpr std::string_view name = "add_particles";
  const size_t count = pos.size();
  check_one_length(name, "vel", vel.size(), count, false);
  check_one_length(name, "mass", mass.size(), count, false);
  check_one_length(name, "radius", radius.size(), count, true);
  check_one_length(name, "flags", flags.size(), count, true);
  require(count <= kMaxCount - particle_q.size(), ErrorKind::Value, name, ": expected at most ",
          kMaxCount, " particles");
  if (count != 0 && radius.empty()) {
    detail::check_not_negative({name, "default_particle_radius"}, default_particle_radius);
  }
  for (size_t i = 0; i < count; ++i) {
    detail::check_finite({name, "pos", i}, pos[i]);
    detail::check_finite({name, "vel", i}, vel[i]);
    detail::check_mass({name, "mass", i}, mass[i]);
    if (!radius.empty()) detail::check_not_negative({name, "radius", i}, radius[i]);
    if (!flags.empty()) detail::check_particle_flags({name, "flags", i}, flags[i]);
  }
  particle_q.insert(particle_q.end(), pos.begin(), pos.end());
  particle_qd.insert(particle_qd.end(), vel.begin(), vel.end());
  particle_mass.insert(particle_mass.end(), mass.begin(), mass.end());
  particle_radius.insert(particle_radius.end(), radius.begin(), radius.end());
  particle_flags.insert(particle_flags.end(), flags.begin(), flags.end());
  const size_t total = particle_q.size();
  particle_radius.resize(total, default_particle_radius);
  particle_flags.resize(total, static_cast<int32_t>(ParticleFlags::ACTIVE));
  particle_world.resize(total, current_world_);
}

int32_t ModelBuilder::append_shape(std::string_view name, const ShapeArgs& args) {
  check_body(name, args.body);
  const Vec3f scale = detail::checked_scale(name, args.type, args.scale);
  const Transformf xform = detail::checked_pose(name, args.xform);
  const ShapeConfig& cfg = args.cfg ? *args.cfg : default_shape_cfg;
  detail::check_shape_config(name, cfg);
  if (!cfg.gap) detail::check_not_negative({name, "rigid_gap"}, rigid_gap);
  require(shapes_.size() < kMaxCount, ErrorKind::Value, name, ": expected at most ", kMaxCount,
          " shapes");
  const int32_t index = shape_count();
  shapes_.push_back({.body = args.body,
                     .type = args.type,
                     .xform = xform,
                     .scale = scale,
                     .cfg = cfg,
                     .gap = cfg.gap.value_or(rigid_gap),
                     .world = current_world_,
                     .label = args.label.empty() ? "shape_" + std::to_string(index) : args.label});
  return index;
}

int32_t ModelBuilder::add_shape(const ShapeArgs& args) { return append_shape("add_shape", args); }

int32_t ModelBuilder::add_shape_plane(const ShapePlaneArgs& args) {
  return append_shape(
      "add_shape_plane",
      {.body = args.body,
       .type = GeoType::PLANE,
       .xform = args.xform ? *args.xform : detail::plane_pose("add_shape_plane", args.plane),
       .scale = {args.width, args.length, 0.0f},
       .cfg = args.cfg,
       .label = args.label});
}

int32_t ModelBuilder::add_ground_plane(const GroundArgs& args) {
  const Vec3f up = up_vector();
  return add_shape_plane({.plane = {up.x, up.y, up.z, -args.height},
                          .width = 0.0f,
                          .length = 0.0f,
                          .cfg = args.cfg,
                          .label = args.label});
}

int32_t ModelBuilder::add_shape_sphere(int32_t body, const ShapeSphereArgs& args) {
  return append_shape("add_shape_sphere", {.body = body,
                                           .type = GeoType::SPHERE,
                                           .xform = args.xform,
                                           .scale = {args.radius, 0.0f, 0.0f},
                                           .cfg = args.cfg,
                                           .label = args.label});
}

int32_t ModelBuilder::add_shape_box(int32_t body, const ShapeBoxArgs& args) {
  return append_shape("add_shape_box", {.body = body,
                                        .type = GeoType::BOX,
                                        .xform = args.xform,
                                        .scale = {args.hx, args.hy, args.hz},
                                        .cfg = args.cfg,
                                        .label = args.label});
}

int32_t ModelBuilder::add_shape_capsule(int32_t body, const ShapeCapsuleArgs& args) {
  return append_shape("add_shape_capsule", {.body = body,
                                            .type = GeoType::CAPSULE,
                                            .xform = args.xform,
                                            .scale = {args.radius, args.half_height, 0.0f},
                                            .cfg = args.cfg,
                                            .label = args.label});
}

void ModelBuilder::add_shape_collision_filter_pair(int32_t a, int32_t b) {
  for (const int32_t shape : {a, b}) {
    require(shape >= 0 && shape < shape_count(), ErrorKind::Index,
            "add_shape_collision_filter_pair: expected shapes from 0 to ", shape_count() - 1,
            ", got ", shape);
  }
  require(a != b, ErrorKind::Value,
          "add_shape_collision_filter_pair: expected two different shapes, got ", a, " twice");
  filter_pairs_.insert(std::minmax(a, b));
}

void ModelBuilder::check_sizes() const {
  const size_t count = particle_q.size();
  const auto check = [&](std::string_view name, size_t size) {
    require(size == count, ErrorKind::Value, "finalize: ", name, ": expected ", count,
            " elements as particle_q has, got ", size);
  };
  check("particle_qd", particle_qd.size());
  check("particle_mass", particle_mass.size());
  check("particle_radius", particle_radius.size());
  check("particle_flags", particle_flags.size());
  check("particle_world", particle_world.size());
  require(count <= kMaxCount, ErrorKind::Value, "finalize: particle_q: expected at most ",
          kMaxCount, " elements, got ", count);
}

void ModelBuilder::check_values() const {
  constexpr std::string_view name = "finalize";
  detail::check_finite({name, "gravity"}, gravity);
  const int32_t worlds = std::max(world_count(), 1);
  for (size_t i = 0; i < particle_q.size(); ++i) {
    detail::check_finite({name, "particle_q", i}, particle_q[i]);
    detail::check_finite({name, "particle_qd", i}, particle_qd[i]);
    detail::check_mass({name, "particle_mass", i}, particle_mass[i]);
    detail::check_not_negative({name, "particle_radius", i}, particle_radius[i]);
    detail::check_particle_flags({name, "particle_flags", i}, particle_flags[i]);
    require(particle_world[i] >= -1 && particle_world[i] < worlds, ErrorKind::Value,
            Where{name, "particle_world", i}, ": expected -1 (all worlds) to ", worlds - 1,
            ", got ", particle_world[i]);
    // A particle of all worlds has the gravity of the last one (see Model::gravity).
    require(particle_world[i] >= 0 || world_gravity_.empty() || gravity == world_gravity_.back(),
            ErrorKind::Value, Where{name, "particle_world", i},
            ": expected a world from 0: a particle of all worlds (-1) needs a gravity of the "
            "builder that the last world has too");
  }
}

}  // namespace novaphy
