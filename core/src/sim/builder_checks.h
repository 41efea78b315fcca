// The checks that ModelBuilder makes in add_* and again in finalize. Each check throws
// ErrorKind::Value with a message that names the argument, the expected value and the given value.
#pragma once

#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/element_args.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/shape_config.h"
#include "novaphy/core/sim/world_settings.h"
#include "novaphy/math/types.h"

namespace novaphy::detail {

// The beginning of an error message: "add_particle: mass" or "finalize: particle_mass[3]".
struct Where {
  std::string_view function, argument;
  std::optional<size_t> element = {};
};
inline std::string message_text(const Where& where) {
  std::string text(where.function);
  text.append(": ").append(where.argument);
  if (where.element) text.append("[").append(std::to_string(*where.element)).append("]");
  return text;
}

inline bool is_finite(const Vec3f& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

inline void check_finite(const Where& where, float value) {
  require(std::isfinite(value), ErrorKind::Value, where, ": expected a finite number, got ", value);
}
inline void check_finite(const Where& where, const Vec3f& v) {
  require(is_finite(v), ErrorKind::Value, where, ": expected finite numbers, got (", v.x, ", ", v.y,
          ", ", v.z, ")");
}
inline void check_not_negative(const Where& where, float value) {
  require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value, where,
          ": expected a finite number >= 0, got ", value);
}
inline void check_positive(const Where& where, float value) {
  require(std::isfinite(value) && value > 0.0f, ErrorKind::Value, where,
          ": expected a finite number > 0, got ", value);
}

// Checks that a mass is 0 or has a finite inverse.
inline void check_mass(const Where& where, float mass) {
  check_not_negative(where, mass);
  require(mass == 0.0f || std::isfinite(1.0f / mass), ErrorKind::Value, where,
          ": expected 0 or a mass whose inverse is finite, got ", mass);
}
inline void check_particle_flags(const Where& where, int32_t flags) {
  require((flags & ~static_cast<int32_t>(ParticleFlags::ACTIVE)) == 0, ErrorKind::Value, where,
          ": expected 0 or ParticleFlags.ACTIVE (1), got ", flags);
}

// Checks that a setting of the last world equals that of the builder, because objects in all worlds
// (-1) have the gravity and the fluid of the last world (see Model::gravity). `name`: the setting's
// name.
template <class T>
void check_world_setting(const Where& where, int32_t world, std::string_view name,
                         const T& of_builder, const std::vector<T>& of_worlds) {
  require(world >= 0 || of_worlds.empty() || of_builder == of_worlds.back(), ErrorKind::Value,
          where, ": expected a world from 0, because objects in all worlds (-1) need the same ",
          name, " of the builder and of the last world");
}

// Throws ErrorKind::Value if a number of a fluid is not finite, or its density or viscosity
// negative.
void check_fluid(std::string_view function, const Fluid& fluid);

// Checks that a list is empty (the default), has one value for all elements, or has one value per
// element.
inline void check_one_or_each(std::string_view function, std::string_view argument, size_t size,
                              size_t elements) {
  require(size <= 1 || size == elements, ErrorKind::Value, function, ": ", argument,
          ": expected one value or ", elements, ", one for each element, got ", size);
}
template <class T>
T one_or_each(std::span<const T> values, size_t element, const T& by_default) {
  return values.empty() ? by_default : values.size() == 1 ? values[0] : values[element];
}
// Checks the sizes of materials, and that they have one kind of elasticity.
void check_tet_materials(std::string_view function, const TetMaterials& materials, size_t count);

// Checks the material and the gap of a shape.
void check_shape_config(std::string_view function, const ShapeConfig& cfg);
// Checks a pose and returns it with a unit quaternion. If the length of the quaternion is 1 up to
// float rounding, the quaternion keeps its bits, so normalizing twice changes nothing. A length
// that differs from 1 by more than 1e-3 is refused.
Transformf checked_pose(const Where& where, const Transformf& xform);
inline Transformf checked_pose(std::string_view function, const Transformf& xform) {
  return checked_pose({function, "xform"}, xform);
}
// Checks the size of a shape and returns it with unused components set to zero.
// ErrorKind::NotImplemented: the type is not supported.
Vec3f checked_scale(std::string_view function, GeoType type, const Vec3f& scale);
// Returns a pose whose local +z is the normal of the plane a*x + b*y + c*z + d = 0. The position is
// the point of the plane nearest to the origin.
Transformf plane_pose(std::string_view function, const Vec4f& plane);

// Bounds of a shape in its own frame, see Model::shape_collision_radius and shape_aabb_lower.
struct ShapeBounds {
  float radius;
  Vec3f lower, upper;
};
ShapeBounds shape_bounds(GeoType type, const Vec3f& scale);
ShapeBounds mesh_bounds(std::span<const Vec3f> vertices, const Vec3f& scale);

}  // namespace novaphy::detail
