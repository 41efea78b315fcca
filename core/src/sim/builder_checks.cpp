#include "builder_checks.h"

#include <algorithm>

namespace novaphy::detail {
namespace {

constexpr float kInfiniteExtent = 1.0e6f;  // stands for infinity in bounds, as in Newton

// The numbers of a scale that a size has. A null name: the number is not used.
struct ScaleNames {
  const char* x = nullptr;
  const char* y = nullptr;
  const char* z = nullptr;
};

ScaleNames scale_names(ShapeSize size) {
  switch (size) {
    case ShapeSize::RECTANGLE:
      return {"scale.x (width)", "scale.y (length)"};
    case ShapeSize::RADIUS:
      return {"scale.x (radius)"};
    case ShapeSize::RADIUS_HEIGHT:
      return {"scale.x (radius)", "scale.y (half_height)"};
    case ShapeSize::HALF_EXTENTS:
      return {"scale.x (hx)", "scale.y (hy)", "scale.z (hz)"};
    case ShapeSize::HALF_AXES:
      return {"scale.x (rx)", "scale.y (ry)", "scale.z (rz)"};
    case ShapeSize::FACTORS:
      return {"scale.x", "scale.y", "scale.z"};
    case ShapeSize::NONE:
      break;
  }
  return {};
}

}  // namespace

void check_tet_materials(std::string_view function, const TetMaterials& of, size_t count) {
  check_one_or_each(function, "k_mu", of.k_mu.size(), count);
  check_one_or_each(function, "k_lambda", of.k_lambda.size(), count);
  check_one_or_each(function, "k_damp", of.k_damp.size(), count);
  check_one_or_each(function, "youngs_modulus", of.youngs_modulus.size(), count);
  check_one_or_each(function, "poisson_ratio", of.poisson_ratio.size(), count);
  const bool young = !of.youngs_modulus.empty(), ratio = !of.poisson_ratio.empty();
  require(young == ratio, ErrorKind::Value, function,
          ": expected youngs_modulus and poisson_ratio together, got only ",
          young ? "youngs_modulus" : "poisson_ratio");
  require(!young || (of.k_mu.empty() && of.k_lambda.empty()), ErrorKind::Value, function,
          ": expected either k_mu and k_lambda, or youngs_modulus and poisson_ratio, got ",
          of.k_mu.empty() ? "k_lambda" : "k_mu", " and youngs_modulus");
}

void check_shape_config(std::string_view function, const ShapeConfig& cfg) {
  check_not_negative({function, "cfg.density"}, cfg.density);
  check_not_negative({function, "cfg.ke"}, cfg.ke);
  check_not_negative({function, "cfg.kd"}, cfg.kd);
  check_not_negative({function, "cfg.kf"}, cfg.kf);
  check_not_negative({function, "cfg.ka"}, cfg.ka);
  check_not_negative({function, "cfg.mu"}, cfg.mu);
  check_not_negative({function, "cfg.restitution"}, cfg.restitution);
  require(cfg.restitution <= 1.0f, ErrorKind::Value, function,
          ": cfg.restitution: expected at most 1, got ", cfg.restitution);
  check_not_negative({function, "cfg.mu_torsional"}, cfg.mu_torsional);
  check_not_negative({function, "cfg.mu_rolling"}, cfg.mu_rolling);
  check_finite({function, "cfg.margin"}, cfg.margin);
  check_finite({function, "cfg.mixing priority"}, cfg.mixing.priority);
  check_not_negative({function, "cfg.mixing weight"}, cfg.mixing.weight);
  check_not_negative({function, "cfg.mixing inverse_mass"}, cfg.mixing.inverse_mass);
  check_not_negative({function, "cfg.mixing mu"}, cfg.mixing.mu);
  if (cfg.gap) check_not_negative({function, "cfg.gap"}, *cfg.gap);
  if (!cfg.color) return;
  const auto part = [](float x) { return x >= 0.0f && x <= 1.0f; };
  const Vec3f& c = *cfg.color;
  require(part(c.x) && part(c.y) && part(c.z), ErrorKind::Value, function,
          ": color: expected three numbers from 0 to 1, got (", c.x, ", ", c.y, ", ", c.z, ")");
}

Transformf checked_pose(const Where& where, const Transformf& xform) {
  require(is_finite(xform.p), ErrorKind::Value, where, ".p: expected finite numbers, got (",
          xform.p.x, ", ", xform.p.y, ", ", xform.p.z, ")");
  const Quatf& q = xform.q;
  const double x = q.x, y = q.y, z = q.z, w = q.w;
  const double norm = std::sqrt(x * x + y * y + z * z + w * w);
  // The comparison is false for NaN.
  require(std::abs(norm - 1.0) <= 1e-3, ErrorKind::Value, where,
          ".q: expected a quaternion of length 1 (to 1e-3), got (", q.x, ", ", q.y, ", ", q.z, ", ",
          q.w, ") of length ", norm);
  constexpr double kFloatRounding = 0x1p-22;
  if (std::abs(norm - 1.0) <= kFloatRounding) return xform;
  return {xform.p,
          {static_cast<float>(x / norm), static_cast<float>(y / norm), static_cast<float>(z / norm),
           static_cast<float>(w / norm)}};
}

Vec3f checked_scale(std::string_view function, GeoType type, const Vec3f& scale) {
  const ShapeSize size = shape_traits(type).size;
  require(type != GeoType::HFIELD, ErrorKind::NotImplemented, function,
          ": type: HFIELD is not supported; use add_shape_mesh with the triangles of a height "
          "field");
  require(type != GeoType::NONE, ErrorKind::Value, function,
          ": type: expected a shape type, got NONE");
  require(size != ShapeSize::NONE, ErrorKind::Value, function, ": type: expected a GeoType, got ",
          static_cast<int32_t>(type));
  const ScaleNames names = scale_names(size);
  const auto checked = [&](const char* name, float value) {
    if (name == nullptr) return 0.0f;
    if (size == ShapeSize::RECTANGLE) {
      check_not_negative({function, name}, value);
    } else {
      check_positive({function, name}, value);
    }
    return value;
  };
  return {checked(names.x, scale.x), checked(names.y, scale.y), checked(names.z, scale.z)};
}

Transformf plane_pose(std::string_view function, const Vec4f& plane) {
  require(std::isfinite(plane.x) && std::isfinite(plane.y) && std::isfinite(plane.z) &&
              std::isfinite(plane.w),
          ErrorKind::Value, function, ": plane: expected finite numbers, got (", plane.x, ", ",
          plane.y, ", ", plane.z, ", ", plane.w, ")");
  const double a = plane.x, b = plane.y, c = plane.z;
  const double norm = std::sqrt(a * a + b * b + c * c);
  require(norm > 0.0, ErrorKind::Value, function,
          ": plane: expected a normal (a, b, c) that is not zero, got (0, 0, 0)");
  const double nx = a / norm, ny = b / norm, nz = c / norm;
  const double offset = -static_cast<double>(plane.w) / norm;
  // The shortest rotation from +z to n is (cross(z, n), 1 + nz), normalized. 1 + nz is computed
  // without cancellation.
  double qx = 0.0 - ny, qy = nx, qw = nz >= 0.0 ? 1.0 + nz : (nx * nx + ny * ny) / (1.0 - nz);
  const double length = std::sqrt(qx * qx + qy * qy + qw * qw);
  if (length > 0.0) {
    qx /= length;
    qy /= length;
    qw /= length;
  } else {  // n = -z: half a turn about x
    qx = 1.0;
  }
  // Adding 0.0 maps -0 to 0.
  Transformf pose;
  pose.p = {static_cast<float>(offset * nx + 0.0), static_cast<float>(offset * ny + 0.0),
            static_cast<float>(offset * nz + 0.0)};
  check_finite({function, "plane"}, pose.p);
  pose.q = {static_cast<float>(qx), static_cast<float>(qy), 0.0f, static_cast<float>(qw)};
  return pose;
}

ShapeBounds shape_bounds(GeoType type, const Vec3f& scale) {
  const ShapeTraits traits = shape_traits(type);
  if (traits.is_rounded) {
    const float r = scale.x, end = scale.x + scale.y;
    return {end, {-r, -r, -end}, {r, r, end}};
  }
  switch (traits.size) {
    case ShapeSize::RADIUS_HEIGHT: {
      const Vec3f upper = {scale.x, scale.x, scale.y};
      return {math::sqrt(scale.x * scale.x + scale.y * scale.y), -upper, upper};
    }
    case ShapeSize::HALF_AXES:
      return {math::max(scale.x, math::max(scale.y, scale.z)), -scale, scale};
    case ShapeSize::HALF_EXTENTS:
      return {math::length(scale), -scale, scale};
    default:
      break;
  }
  // Bounds of the face of a PLANE. The half-space below the face is solid and unbounded.
  if (scale.x > 0.0f && scale.y > 0.0f) {
    const Vec3f half = {scale.x * 0.5f, scale.y * 0.5f, 0.0f};
    return {math::length(half), {-half.x, -half.y, 0.0f}, half};
  }
  return {kInfiniteExtent,
          {-kInfiniteExtent, -kInfiniteExtent, 0.0f},
          {kInfiniteExtent, kInfiniteExtent, 0.0f}};
}

ShapeBounds mesh_bounds(std::span<const Vec3f> vertices, const Vec3f& scale) {
  ShapeBounds bounds{0.0f, vertices[0], vertices[0]};
  for (size_t i = 0; i < vertices.size(); ++i) {
    const Vec3f& v = vertices[i];
    const Vec3f x = {v.x * scale.x, v.y * scale.y, v.z * scale.z};
    bounds.radius = math::max(bounds.radius, math::length(x));
    bounds.lower = i == 0 ? x
                          : Vec3f{math::min(bounds.lower.x, x.x), math::min(bounds.lower.y, x.y),
                                  math::min(bounds.lower.z, x.z)};
    bounds.upper = i == 0 ? x
                          : Vec3f{math::max(bounds.upper.x, x.x), math::max(bounds.upper.y, x.y),
                                  math::max(bounds.upper.z, x.z)};
  }
  return bounds;
}

}  // namespace novaphy::detail
