// Worlds of a ModelBuilder, and adding a builder to another builder.
#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

template <class T>
void append(std::vector<T>& to, const std::vector<T>& values) {
  to.insert(to.end(), values.begin(), values.end());
}

// Appends rows of particle indices, shifted by first_particle. Missing particles (-1) stay -1.
template <class Row>
void append_indices(std::vector<Row>& to, const std::vector<Row>& rows, int32_t first_particle) {
  const auto moved = [first_particle](int32_t p) { return p < 0 ? p : p + first_particle; };
  to.reserve(to.size() + rows.size());
  for (Row row : rows) {
    row.x = moved(row.x);
    row.y = moved(row.y);
    if constexpr (!std::is_same_v<Row, Vec2i>) row.z = moved(row.z);
    if constexpr (std::is_same_v<Row, Vec4i>) row.w = moved(row.w);
    to.push_back(row);
  }
}

// Returns the positions of the copies of ModelBuilder::replicate, on the same grid as in Newton.
std::vector<Vec3f> world_offsets(int32_t count, const Vec3f& spacing, Axis up_axis) {
  const float step[3] = {spacing.x, spacing.y, spacing.z};
  std::vector<int> axes;
  for (int axis = 0; axis < 3; ++axis)
    if (step[axis] != 0.0f) axes.push_back(axis);
  std::vector<Vec3f> offsets(static_cast<size_t>(count));
  if (axes.empty() || count == 0) return offsets;
  const auto side = static_cast<int32_t>(
      std::ceil(std::pow(static_cast<double>(count), 1.0 / static_cast<double>(axes.size()))));
  float lower[3] = {}, upper[3] = {};
  for (int32_t world = 0; world < count; ++world) {
    float at[3] = {};
    int32_t rest = world;
    for (size_t k = 0; k < axes.size(); ++k) {
      const bool last = k + 1 == axes.size();
      const int axis = axes[k];
      at[axis] = static_cast<float>(last ? rest : rest % side) * step[axis];
      rest /= side;
      lower[axis] = world == 0 ? at[axis] : std::min(lower[axis], at[axis]);
      upper[axis] = world == 0 ? at[axis] : std::max(upper[axis], at[axis]);
    }
    offsets[static_cast<size_t>(world)] = {at[0], at[1], at[2]};
  }
  float center[3];
  for (int axis = 0; axis < 3; ++axis)
    center[axis] =
        axis == static_cast<int>(up_axis) ? 0.0f : lower[axis] + (upper[axis] - lower[axis]) / 2.0f;
  for (Vec3f& offset : offsets) offset = offset - Vec3f{center[0], center[1], center[2]};
  return offsets;
}

}  // namespace

int32_t ModelBuilder::begin_world(std::optional<Vec3f> world_gravity) {
  require(current_world_ < 0, ErrorKind::Runtime, "begin_world: world ", current_world_,
          " is open; call end_world() first");
  const Vec3f value = world_gravity.value_or(gravity);
  detail::check_finite({"begin_world", "gravity"}, value);
  detail::check_fluid("begin_world", fluid);
  world_gravity_.push_back(value);
  world_fluid_.push_back(fluid);
  current_world_ = world_count() - 1;
  return current_world_;
}

void ModelBuilder::end_world() {
  require(current_world_ >= 0, ErrorKind::Runtime, "end_world: no world is open");
  current_world_ = -1;
}

void ModelBuilder::check_addable(std::string_view function, const ModelBuilder& builder,
                                 int64_t copies) const {
  require(&builder != this, ErrorKind::Value, function,
          ": builder: expected another builder, got this one");
  require(builder.up_axis_ == up_axis_, ErrorKind::Value, function,
          ": builder: expected the up axis ", static_cast<int32_t>(up_axis_), ", got ",
          static_cast<int32_t>(builder.up_axis_));
  builder.check_sizes();
  detail::check_finite({function, "builder.gravity"}, builder.gravity);
  detail::check_fluid(function, builder.fluid);
  const auto check = [&](const char* what, size_t here, size_t added) {
    const int64_t total = static_cast<int64_t>(here) + copies * static_cast<int64_t>(added);
    require(total <= std::numeric_limits<int32_t>::max(), ErrorKind::Value, function,
            ": expected at most ", std::numeric_limits<int32_t>::max(), " ", what, ", got ", total);
  };
  check("particles", particle_q.size(), builder.particle_q.size());
  check("bodies", bodies_.size(), builder.bodies_.size());
  check("shapes", shapes_.size(), builder.shapes_.size());
  check("joints", joints_.size(), builder.joints_.size());
  check("actuators", static_cast<size_t>(actuator_count()),
        static_cast<size_t>(builder.actuator_count()));
  check("joint coordinates", joint_q.size(), builder.joint_q.size());
  check("springs", springs_.indices.size(), builder.springs_.indices.size());
  check("triangles", triangles_.indices.size(), builder.triangles_.indices.size());
  check("bending edges", edges_.indices.size(), builder.edges_.indices.size());
  check("tetrahedra", tetrahedra_.indices.size(), builder.tetrahedra_.indices.size());
}

void ModelBuilder::append_elements(const ModelBuilder& b) {
  const int32_t first = particle_count();
  append_indices(springs_.indices, b.springs_.indices, first);
  append(springs_.rest_length, b.springs_.rest_length);
  append(springs_.stiffness, b.springs_.stiffness);
  append(springs_.damping, b.springs_.damping);
  append(springs_.control, b.springs_.control);
  append(springs_.tension_only, b.springs_.tension_only);
  append_indices(triangles_.indices, b.triangles_.indices, first);
  append(triangles_.pose, b.triangles_.pose);
  append(triangles_.area, b.triangles_.area);
  append(triangles_.material, b.triangles_.material);
  append_indices(edges_.indices, b.edges_.indices, first);
  append(edges_.rest_angle, b.edges_.rest_angle);
  append(edges_.rest_length, b.edges_.rest_length);
  append(edges_.material, b.edges_.material);
  append_indices(tetrahedra_.indices, b.tetrahedra_.indices, first);
  append(tetrahedra_.pose, b.tetrahedra_.pose);
  append(tetrahedra_.volume, b.tetrahedra_.volume);
  append(tetrahedra_.material, b.tetrahedra_.material);
  append(tetrahedra_.is_lame, b.tetrahedra_.is_lame);
}

void ModelBuilder::add_builder(const ModelBuilder& b, const Transformf& given) {
  constexpr std::string_view name = "add_builder";
  check_addable(name, b, 1);
  const Transformf xform = detail::checked_pose(name, given);
  // The identity transform is skipped, so that it keeps the bits.
  const Transformf identity = Transformf::identity();
  const bool moves = xform != identity, turns = xform.q != identity.q;

  append_elements(b);
  for (size_t p = 0; p < b.particle_q.size(); ++p) {
    particle_q.push_back(moves ? math::transform_point(xform, b.particle_q[p]) : b.particle_q[p]);
    particle_qd.push_back(turns ? math::rotate(xform.q, b.particle_qd[p]) : b.particle_qd[p]);
  }
  append(particle_mass, b.particle_mass);
  append(particle_radius, b.particle_radius);
  append(particle_flags, b.particle_flags);
  if (!b.colors_.empty()) {
    colors_.resize(particle_q.size() - b.particle_q.size(), -1);
    append(colors_, b.colors_);
    color_check_ = std::min(color_check_, b.color_check_);
  }
  particle_world.resize(particle_q.size(), current_world_);

  const int32_t first_shape = shape_count(), first_body = body_count();
  append_bodies(b, xform);
  append(refused_, b.refused_);
  actuators_.append(b.actuators_, joint_dof_count(), first_body, xform);
  append_joints(b, first_body, xform);
  for (Shape shape : b.shapes_) {
    if (moves && shape.body < 0) shape.xform = math::multiply(xform, shape.xform);
    if (shape.body >= 0) shape.body += first_body;
    shape.world = current_world_;
    shapes_.push_back(std::move(shape));
  }
  for (const auto& [i, j] : b.filter_pairs_)
    filter_pairs_.insert({i + first_shape, j + first_shape});

  (current_world_ < 0 ? gravity : world_gravity_[static_cast<size_t>(current_world_)]) = b.gravity;
  (current_world_ < 0 ? fluid : world_fluid_[static_cast<size_t>(current_world_)]) = b.fluid;
}

int32_t ModelBuilder::add_world(const ModelBuilder& builder, const Transformf& xform) {
  check_addable("add_world", builder, 1);
  const Transformf pose = detail::checked_pose("add_world", xform);
  const int32_t world = begin_world();
  add_builder(builder, pose);
  end_world();
  return world;
}

void ModelBuilder::replicate(const ModelBuilder& builder, int32_t count, const Vec3f& spacing) {
  constexpr std::string_view name = "replicate";
  require(count >= 0, ErrorKind::Value, name, ": world_count: expected >= 0, got ", count);
  detail::check_finite({name, "spacing"}, spacing);
  require(current_world_ < 0, ErrorKind::Runtime, name, ": world ", current_world_,
          " is open; call end_world() first");
  check_addable(name, builder, count);
  for (const Vec3f& offset : world_offsets(count, spacing, up_axis_)) {
    Transformf xform = Transformf::identity();
    xform.p = offset;
    add_world(builder, xform);
  }
}

}  // namespace novaphy
