// Checks and normalization of the axes of joints in a ModelBuilder.
#pragma once

#include <cmath>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/math/functions.h"

namespace novaphy::detail {

struct JointSize {
  int32_t linear, angular, coords;
  int32_t dofs() const { return linear + angular; }
};

inline JointSize joint_size(JointType type, const JointArgs& args) {
  const JointTraits traits = joint_traits(type);
  const auto linear = static_cast<int32_t>(args.linear_axes.size());
  const auto angular = static_cast<int32_t>(args.angular_axes.size());
  return {linear + traits.linear, angular + traits.angular,
          coordinate_count(type, linear + angular)};
}

inline Vec3f unit_axis(std::string_view name, const Vec3f& axis) {
  const double x = axis.x, y = axis.y, z = axis.z, length = std::sqrt(x * x + y * y + z * z);
  require(is_finite(axis) && length > 1e-6, ErrorKind::Value, name,
          ": axis: expected a finite vector that is not zero, got (", axis.x, ", ", axis.y, ", ",
          axis.z, ")");
  // An axis of unit length keeps its bits.
  if (std::abs(length - 1.0) <= 0x1p-23) return axis;
  return {static_cast<float>(x / length), static_cast<float>(y / length),
          static_cast<float>(z / length)};
}

// Checks that unit axes are linearly independent, by the volume of three axes or the area of two.
inline void check_independent(std::string_view name, const char* argument,
                              std::span<const Vec3f> axes) {
  if (axes.size() < 2) return;
  const Vec3f normal = math::cross(axes[0], axes[1]);
  const float size = axes.size() == 2 ? math::length(normal) : std::abs(math::dot(normal, axes[2]));
  require(size > 1e-3f, ErrorKind::Value, name, ": ", argument,
          ": expected linearly independent axes, got ", axes.size(), " whose ",
          axes.size() == 2 ? "cross" : "triple", " product is ", size);
}

inline void check_plane(std::string_view name, std::span<const Vec3f> axes) {
  // triple product of the unit vectors
  const float volume = math::dot(math::cross(axes[0], axes[1]), axes[2]);
  require(volume > 0.999f, ErrorKind::Value, name,
          ": linear_axes, angular_axes: expected two perpendicular axes and their cross product of "
          "a PLANAR joint, got axes whose triple product is ",
          volume);
}

// Returns the axes x and y of the plane with a given normal: the images of x and y under the
// shortest rotation from z to the normal.
inline std::pair<Vec3f, Vec3f> plane_axes(const Vec3f& normal) {
  const double length = std::sqrt(math::dot(Vec3<double>{normal.x, normal.y, normal.z},
                                            Vec3<double>{normal.x, normal.y, normal.z}));
  const double a = normal.x / length, b = normal.y / length, c = normal.z / length, s = 1.0 + c;
  if (s < 1e-12) return {{1.0f, 0.0f, 0.0f}, {0.0f, -1.0f, 0.0f}};
  const auto vector = [](double x, double y, double z) {
    return Vec3f{static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)};
  };
  return {vector(1.0 - a * a / s, -a * b / s, -a), vector(-a * b / s, 1.0 - b * b / s, -b)};
}

inline std::vector<Vec3f> joint_axes(std::string_view name, JointType type, const JointArgs& args,
                                     const JointSize& size) {
  std::vector<Vec3f> axes;
  for (const auto* configs : {&args.linear_axes, &args.angular_axes})
    for (const JointDofConfig& dof : *configs) axes.push_back(unit_axis(name, dof.axis));
  if (axes.empty())
    for (int32_t k = 0; k < size.dofs(); ++k) axes.push_back(axis_vector(static_cast<Axis>(k % 3)));
  const auto linear = static_cast<size_t>(size.linear);
  check_independent(name, "linear_axes", std::span(axes).first(linear));
  check_independent(name, "angular_axes", std::span(axes).subspan(linear));
  if (type == JointType::PLANAR) check_plane(name, axes);
  return axes;
}

}  // namespace novaphy::detail
