// Single elements: springs, triangles, bending edges, tetrahedra.
#include <algorithm>
#include <limits>

#include "builder_checks.h"
#include "builder_transaction.h"
#include "novaphy/core/error.h"
#include "novaphy/math/hinge.h"
#include "rest_shape.h"

namespace novaphy {
namespace {

constexpr size_t kMaxElements = static_cast<size_t>(std::numeric_limits<int32_t>::max());

// The name of an element in error messages: "add_triangle: triangle 3 (particles 4, 5, 6)".
struct Element {
  std::string_view function, kind;
  size_t number;
  std::initializer_list<int32_t> particles;
};
std::string message_text(const Element& e) {
  std::string text(e.function);
  text.append(": ").append(e.kind).append(" ").append(std::to_string(e.number));
  const char* separator = " (particles ";
  for (const int32_t p : e.particles) {
    text.append(separator).append(std::to_string(p));
    separator = ", ";
  }
  return text + ")";
}

void check_particle(const Element& e, int32_t particle, int32_t count, bool may_be_absent = false) {
  require((particle >= 0 && particle < count) || (may_be_absent && particle == -1),
          ErrorKind::Index, e, ": expected particles from 0 to ", count - 1,
          may_be_absent ? ", or -1" : "", ", got ", particle);
}
void check_capacity(const Element& e) {
  require(e.number < kMaxElements, ErrorKind::Value, e, ": expected at most ", kMaxElements,
          " of them");
}
// Checks that a material is finite and >= 0. The message names the element, because each element
// may have its own material.
void check_material(const Element& e, const char* name, float value) {
  require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value, e, ": ", name,
          ": expected a finite number >= 0, got ", value);
}
// Sets mu and lambda to the Lame parameters of Young's modulus and Poisson's ratio.
void set_lame(const Element& e, float young, float ratio, float& mu, float& lambda) {
  require(std::isfinite(young) && young > 0.0f, ErrorKind::Value, e,
          ": youngs_modulus: expected a finite number > 0, got ", young);
  require(ratio > -1.0f && ratio < 0.5f, ErrorKind::Value, e,
          ": poisson_ratio: expected a number above -1 and below 0.5, got ", ratio);
  const double shear = 0.5 * double{young} / (1.0 + double{ratio});
  mu = static_cast<float>(shear);
  lambda = static_cast<float>(2.0 * shear * double{ratio} / (1.0 - 2.0 * double{ratio}));
  require(std::isfinite(mu) && std::isfinite(lambda), ErrorKind::Value, e,
          ": youngs_modulus: expected Lame parameters within float32, got ", young,
          " with poisson_ratio ", ratio);
}
// Checks the size of an element. `relative` is the size relative to the longest edge. NaN fails.
void check_size(const Element& e, const char* what, double relative, double size) {
  require(relative > detail::kSmallestRelativeSize, ErrorKind::Value, e, ": expected ", what,
          " above ", detail::kSmallestRelativeSize, " relative to its longest edge, got ", relative,
          " (", size,
          relative < -detail::kSmallestRelativeSize ? "): it is inverted, swap two of its particles"
                                                    : "): it is degenerate");
}

}  // namespace

void ModelBuilder::append_spring(std::string_view function, const Vec2i& spring, float ke, float kd,
                                 float control, bool tension_only) {
  const Element e{function, "spring", springs_.indices.size(), {spring.x, spring.y}};
  check_particle(e, spring.x, particle_count());
  check_particle(e, spring.y, particle_count());
  check_material(e, "ke", ke);
  check_material(e, "kd", kd);
  detail::check_finite({function, "control"}, control);
  check_capacity(e);
  const float length = math::length(particle_q[static_cast<size_t>(spring.x)] -
                                    particle_q[static_cast<size_t>(spring.y)]);
  require(std::isfinite(length) && length > 0.0f, ErrorKind::Value, e,
          ": expected a rest length > 0, got ", length);
  springs_.indices.push_back(spring);
  springs_.rest_length.push_back(length);
  springs_.stiffness.push_back(ke);
  springs_.damping.push_back(kd);
  springs_.control.push_back(control);
  springs_.tension_only.push_back(tension_only ? 1 : 0);
}

float ModelBuilder::append_triangle(std::string_view function, const Vec3i& triangle,
                                    const TriMaterial& material) {
  const auto [i, j, k] = triangle;
  const Element e{function, "triangle", triangles_.indices.size(), {i, j, k}};
  for (const int32_t particle : {i, j, k}) check_particle(e, particle, particle_count());
  const float values[] = {
      material.ke.value_or(default_tri_ke), material.ka.value_or(default_tri_ka),
      material.kd.value_or(default_tri_kd), material.drag.value_or(default_tri_drag),
      material.lift.value_or(default_tri_lift)};
  const char* const names[] = {"tri_ke", "tri_ka", "tri_kd", "tri_drag", "tri_lift"};
  for (size_t c = 0; c < 5; ++c) check_material(e, names[c], values[c]);
  check_capacity(e);
  const detail::TriangleRest rest =
      detail::triangle_rest(particle_q[static_cast<size_t>(i)], particle_q[static_cast<size_t>(j)],
                            particle_q[static_cast<size_t>(k)]);
  check_size(e, "an area", rest.relative, static_cast<double>(rest.area));
  triangles_.indices.push_back(triangle);
  triangles_.pose.push_back(rest.pose);
  triangles_.area.push_back(rest.area);
  triangles_.material.insert(triangles_.material.end(), std::begin(values), std::end(values));
  return rest.area;
}

float ModelBuilder::append_tetrahedron(std::string_view function, const Vec4i& tetrahedron,
                                       const TetMaterials& materials, size_t n) {
  const auto [i, j, k, l] = tetrahedron;
  const Element e{function, "tetrahedron", tetrahedra_.indices.size(), {i, j, k, l}};
  for (const int32_t particle : {i, j, k, l}) check_particle(e, particle, particle_count());
  const bool is_lame = !materials.youngs_modulus.empty();
  float mu = detail::one_or_each(materials.k_mu, n, default_tet_k_mu);
  float lambda = detail::one_or_each(materials.k_lambda, n, default_tet_k_lambda);
  if (is_lame) {
    set_lame(e, detail::one_or_each(materials.youngs_modulus, n, 0.0f),
             detail::one_or_each(materials.poisson_ratio, n, 0.0f), mu, lambda);
  } else {
    check_material(e, "k_mu", mu);
    check_material(e, "k_lambda", lambda);
  }
  const float damp = detail::one_or_each(materials.k_damp, n, default_tet_k_damp);
  check_material(e, "k_damp", damp);
  check_capacity(e);
  const detail::TetrahedronRest rest = detail::tetrahedron_rest(
      particle_q[static_cast<size_t>(i)], particle_q[static_cast<size_t>(j)],
      particle_q[static_cast<size_t>(k)], particle_q[static_cast<size_t>(l)]);
  check_size(e, "a volume", rest.relative, static_cast<double>(rest.volume));
  tetrahedra_.indices.push_back(tetrahedron);
  tetrahedra_.pose.push_back(rest.pose);
  tetrahedra_.volume.push_back(rest.volume);
  tetrahedra_.material.insert(tetrahedra_.material.end(), {mu, lambda, damp});
  tetrahedra_.is_lame.push_back(is_lame ? 1 : 0);
  return rest.volume;
}

void ModelBuilder::append_edge(std::string_view function, const Vec4i& edge,
                               std::optional<float> rest, const EdgeMaterial& material) {
  const auto [i, j, k, l] = edge;
  const Element e{function, "edge", edges_.indices.size(), {i, j, k, l}};
  check_particle(e, i, particle_count(), true);
  check_particle(e, j, particle_count(), true);
  check_particle(e, k, particle_count());
  check_particle(e, l, particle_count());
  require(i != j || i == -1, ErrorKind::Value, e,
          ": expected two different opposite particles, "
          "got ",
          i, " twice");
  const float ke = material.ke.value_or(default_edge_ke);
  const float kd = material.kd.value_or(default_edge_kd);
  check_material(e, "edge_ke", ke);
  check_material(e, "edge_kd", kd);
  require(!rest || std::isfinite(*rest), ErrorKind::Value, e,
          ": rest: expected a finite angle, got ", rest.value_or(0.0f));
  check_capacity(e);
  const auto position = [&](int32_t p) { return particle_q[static_cast<size_t>(p)]; };
  const Vec3f x3 = position(k), x4 = position(l);
  const float length = math::length(x4 - x3);
  require(std::isfinite(length) && length > 0.0f, ErrorKind::Value, e,
          ": expected an edge of a length > 0, got ", length);
  for (const int32_t opposite : {i, j})
    if (opposite != -1) {
      const detail::TriangleRest side = detail::triangle_rest(position(opposite), x3, x4);
      check_size(e, "two triangles with an area", side.relative, static_cast<double>(side.area));
    }
  const bool is_border = i == -1 || j == -1;
  const float angle = rest        ? *rest
                      : is_border ? 0.0f
                                  : math::make_hinge(position(i), position(j), x3, x4).angle;
  edges_.indices.push_back(edge);
  edges_.rest_angle.push_back(angle);
  edges_.rest_length.push_back(length);
  edges_.material.insert(edges_.material.end(), {ke, kd});
}

int32_t ModelBuilder::add_spring(int32_t i, int32_t j, float ke, float kd, float control,
                                 bool tension_only) {
  append_spring("add_spring", {i, j}, ke, kd, control, tension_only);
  return spring_count() - 1;
}

float ModelBuilder::add_triangle(int32_t i, int32_t j, int32_t k, const TriMaterial& material) {
  return append_triangle("add_triangle", {i, j, k}, material);
}

std::vector<float> ModelBuilder::add_triangles(std::span<const Vec3i> indices,
                                               std::span<const TriMaterial> materials) {
  constexpr std::string_view name = "add_triangles";
  detail::check_one_or_each(name, "materials", materials.size(), indices.size());
  Transaction transaction(*this);
  std::vector<float> areas;
  areas.reserve(indices.size());
  for (size_t n = 0; n < indices.size(); ++n)
    areas.push_back(
        append_triangle(name, indices[n], detail::one_or_each(materials, n, TriMaterial{})));
  transaction.keep();
  return areas;
}

float ModelBuilder::add_tetrahedron(int32_t i, int32_t j, int32_t k, int32_t l,
                                    std::optional<float> k_mu, std::optional<float> k_lambda,
                                    std::optional<float> k_damp) {
  return add_tetrahedron(i, j, k, l, {one_of(k_mu), one_of(k_lambda), one_of(k_damp)});
}

float ModelBuilder::add_tetrahedron(int32_t i, int32_t j, int32_t k, int32_t l,
                                    const TetMaterials& material) {
  constexpr std::string_view name = "add_tetrahedron";
  detail::check_tet_materials(name, material, 1);
  return append_tetrahedron(name, {i, j, k, l}, material, 0);
}

std::vector<float> ModelBuilder::add_tetrahedra(std::span<const Vec4i> indices,
                                                const TetMaterials& materials) {
  constexpr std::string_view name = "add_tetrahedra";
  detail::check_tet_materials(name, materials, indices.size());
  Transaction transaction(*this);
  std::vector<float> volumes;
  volumes.reserve(indices.size());
  for (size_t n = 0; n < indices.size(); ++n)
    volumes.push_back(append_tetrahedron(name, indices[n], materials, n));
  transaction.keep();
  return volumes;
}

int32_t ModelBuilder::add_edge(int32_t i, int32_t j, int32_t k, int32_t l,
                               std::optional<float> rest, const EdgeMaterial& material) {
  append_edge("add_edge", {i, j, k, l}, rest, material);
  return edge_count() - 1;
}

void ModelBuilder::add_edges(std::span<const Vec4i> indices, std::span<const float> rest,
                             std::span<const EdgeMaterial> materials) {
  constexpr std::string_view name = "add_edges";
  require(rest.empty() || rest.size() == indices.size(), ErrorKind::Value, name,
          ": rest: expected ", indices.size(), " angles (or none), got ", rest.size());
  detail::check_one_or_each(name, "materials", materials.size(), indices.size());
  Transaction transaction(*this);
  for (size_t n = 0; n < indices.size(); ++n)
    append_edge(name, indices[n], rest.empty() ? std::nullopt : std::optional(rest[n]),
                detail::one_or_each(materials, n, EdgeMaterial{}));
  transaction.keep();
}

}  // namespace novaphy
