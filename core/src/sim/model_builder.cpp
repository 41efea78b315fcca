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
  for (const auto& [name, size] : {std::pair<std::string_view, size_t>{"body_q", body_q.size()},
                                   {"body_qd", body_qd.size()}}) {
    require(size == bodies_.size(), ErrorKind::Value, "finalize: ", name, ": expected ",
            bodies_.size(), " elements, one for each body, got ", size);
  }
  const auto check_joint_list = [&](std::string_view name, size_t size, size_t expected) {
    require(size == expected, ErrorKind::Value, "finalize: ", name, ": expected ", expected,
            " elements, the coordinates or degrees of freedom of the joints, got ", size);
  };
  const auto coords = static_cast<size_t>(next_coord()), dofs = static_cast<size_t>(next_dof());
  check_joint_list("joint_q", joint_q.size(), coords);
  check_joint_list("joint_target_q", joint_target_q.size(), coords);
  check_joint_list("joint_target_mode", joint_target_mode.size(), dofs);
#define NOVAPHY_CHECK_LIST(list, ...) check_joint_list(#list, list.size(), dofs);
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_CHECK_LIST)
#undef NOVAPHY_CHECK_LIST
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
    detail::check_world_setting({name, "particle_world", i}, particle_world[i], "gravity", gravity,
                                world_gravity_);
  }
}

}  // namespace novaphy
