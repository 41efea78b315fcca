// The types of shapes, with the traits that the builder, the search for contacts, gradients and
// Python need. A type is one line of the list.
#pragma once

#include <cstdint>

namespace novaphy {

// The numbers of Model::shape_scale.
enum class ShapeSize : int32_t {
  NONE,
  RECTANGLE,      // (width, length, 0) in m: local +z is the normal; infinite unless both are > 0
  RADIUS,         // (radius, 0, 0) in m
  RADIUS_HEIGHT,  // (radius, half_height, 0) in m, along local z
  HALF_EXTENTS,   // (hx, hy, hz) in m
  HALF_AXES,      // (rx, ry, rz) in m
  FACTORS,        // (x, y, z): factors of the vertices of Model::mesh_vertices
};

struct ShapeTraits {
  ShapeSize size = ShapeSize::NONE;
  int32_t plane_contacts = 0;        // largest number of contacts with a plane
  bool is_convex = false;            // a bounded convex solid
  bool is_rounded = false;           // a point or segment with a radius
  bool is_curved = false;            // has a curved surface, and is not rounded
  bool has_closed_distance = false;  // the signed distance of a point has a closed form
};

// X(name, value, traits). The half height of a CAPSULE excludes the caps. The apex of a CONE is at
// +half_height. HFIELD is reserved: adding one throws ErrorKind::NotImplemented. The values equal
// those of Newton 1.8.
#define NOVAPHY_SHAPE_TYPES(X)                                           \
  X(NONE, 0, {})                                                         \
  X(PLANE, 1, {ShapeSize::RECTANGLE})                                    \
  X(HFIELD, 2, {})                                                       \
  X(SPHERE, 3, {ShapeSize::RADIUS, 1, true, true, false, true})          \
  X(CAPSULE, 4, {ShapeSize::RADIUS_HEIGHT, 2, true, true, false, true})  \
  X(ELLIPSOID, 5, {ShapeSize::HALF_AXES, 1, true, false, true, false})   \
  X(CYLINDER, 6, {ShapeSize::RADIUS_HEIGHT, 5, true, false, true, true}) \
  X(BOX, 7, {ShapeSize::HALF_EXTENTS, 4, true, false, false, true})      \
  X(MESH, 8, {ShapeSize::FACTORS, 4, false, false, false, false})        \
  X(CONE, 9, {ShapeSize::RADIUS_HEIGHT, 5, true, false, true, true})     \
  X(CONVEX_MESH, 10, {ShapeSize::FACTORS, 4, true, false, false, false})

// The values of Model::shape_type.
enum class GeoType : int32_t {
#define NOVAPHY_VALUE(name, value, ...) name = value,
  NOVAPHY_SHAPE_TYPES(NOVAPHY_VALUE)
#undef NOVAPHY_VALUE
};

constexpr ShapeTraits shape_traits(GeoType type) {
  switch (type) {
#define NOVAPHY_TRAITS(name, value, ...) \
  case GeoType::name:                    \
    return ShapeTraits __VA_ARGS__;
    NOVAPHY_SHAPE_TYPES(NOVAPHY_TRAITS)
#undef NOVAPHY_TRAITS
  }
  return {};
}

// Returns whether a type has a trait, without a branch.
template <bool ShapeTraits::*trait>
constexpr bool has_trait(GeoType type) {
  constexpr uint32_t kTypes =
#define NOVAPHY_BIT(name, value, ...) ((ShapeTraits __VA_ARGS__).*trait ? 1u << value : 0u) |
      NOVAPHY_SHAPE_TYPES(NOVAPHY_BIT) 0u;
#undef NOVAPHY_BIT
  const auto bit = static_cast<uint32_t>(type);
  return bit < 32 && (kTypes >> bit & 1u) != 0;
}

}  // namespace novaphy
