#include "element_forces.h"

#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/dynamics/semi_implicit/bending_trace.h"
#include "novaphy/dynamics/semi_implicit/spring_trace.h"
#include "novaphy/dynamics/semi_implicit/tetrahedron_trace.h"
#include "novaphy/dynamics/semi_implicit/triangle_trace.h"

namespace novaphy {
namespace {

constexpr int64_t kChunk = 128;  // elements per thread

// Calls body(element, forces of its entries) for every element. An element has `width` entries, one
// per corner.
template <class Body>
void for_elements(int32_t count, size_t width, std::vector<Vec3f>& forces, Body&& body) {
  for_chunks(count, kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t e = begin; e < end; ++e) body(e, forces.data() + static_cast<size_t>(e) * width);
  });
}

// The positions and velocities of the corners of an element. A missing corner is zero.
template <size_t N>
struct Corners {
  Vec3f x[N], v[N];
  Corners(const int32_t (&particles)[N], const Vec3f* q, const Vec3f* qd) {
    for (size_t c = 0; c < N; ++c) {
      if (particles[c] < 0) continue;
      x[c] = q[particles[c]];
      v[c] = qd[particles[c]];
    }
  }
};

void springs(const Model& m, const Vec3f* q, const Vec3f* qd, std::vector<Vec3f>& forces) {
  const Vec2i* ends = m.particle_spring_indices.data();
  const float* ke = m.particle_spring_stiffness.data();
  const float* kd = m.particle_spring_damping.data();
  const float* rest = m.particle_spring_rest_length.data();
  for_elements(m.spring_count(), 2, forces, [&](int64_t e, Vec3f* f) {
    const auto [i, j] = ends[e];
    const SpringForces<float> s = spring_forces(q[i], q[j], qd[i], qd[j], ke[e], kd[e], rest[e]);
    f[0] = s.f0;
    f[1] = s.f1;
  });
}

void triangles(const Model& m, const float* activation, const Vec3f* q, const Vec3f* qd,
               std::vector<Vec3f>& forces) {
  const Vec3i* corners = m.particle_tri_indices.data();
  const Mat22f* pose = m.particle_tri_pose.data();
  const float* material = m.particle_tri_material.data();
  for_elements(m.tri_count(), 3, forces, [&](int64_t e, Vec3f* f) {
    const auto [i, j, k] = corners[e];
    const Corners<3> at({i, j, k}, q, qd);
    const float* c = material + 5 * e;
    const TriangleForces<float> t =
        triangle_forces<float>(at.x, at.v, pose[e], activation[e], {c[0], c[1], c[2], c[3], c[4]});
    f[0] = t.f0;
    f[1] = t.f1;
    f[2] = t.f2;
  });
}

void edges(const Model& m, const Vec3f* q, const Vec3f* qd, std::vector<Vec3f>& forces) {
  const Vec4i* vertices = m.particle_edge_indices.data();
  const float* material = m.particle_edge_material.data();
  const float* rest = m.particle_edge_rest_angle.data();
  for_elements(m.edge_count(), 4, forces, [&](int64_t e, Vec3f* f) {
    const auto [i, j, k, l] = vertices[e];
    const Corners<4> at({i, j, k, l}, q, qd);
    const bool complete = i >= 0 && j >= 0 && k >= 0 && l >= 0;
    const BendingForces<float> b = bending_forces<bool, float>(
        complete, at.x, at.v, material[2 * e], material[2 * e + 1], rest[e]);
    f[0] = b.f1;
    f[1] = b.f2;
    f[2] = b.f3;
    f[3] = b.f4;
  });
}

void tetrahedra(const Model& m, const float* activation, const Vec3f* q, const Vec3f* qd,
                std::vector<Vec3f>& forces) {
  const Vec4i* corners = m.particle_tet_indices.data();
  const Mat33f* pose = m.particle_tet_pose.data();
  const float* material = m.particle_tet_material.data();
  const int32_t* is_lame = m.particle_tet_is_lame.data();
  for_elements(m.tet_count(), 4, forces, [&](int64_t e, Vec3f* f) {
    const auto [i, j, k, l] = corners[e];
    const Corners<4> at({i, j, k, l}, q, qd);
    const float* c = material + 3 * e;
    const TetrahedronForces<float> t = tetrahedron_forces<float>(
        at.x, at.v, pose[e], activation[e],
        coefficients_of<bool, float>(is_lame[e] != 0, {c[0], c[1], c[2]}));
    f[0] = t.f0;
    f[1] = t.f1;
    f[2] = t.f2;
    f[3] = t.f3;
  });
}

}  // namespace

bool ElementForces::any(const Model& m) {
  return m.spring_count() > 0 || m.tri_count() > 0 || m.edge_count() > 0 || m.tet_count() > 0;
}

void ElementForces::Table::update(const Array& indices, int32_t particles, const char* name,
                                  bool may_be_absent) {
  rows.update(indices, particles, name, may_be_absent);
  forces.resize(indices.bytes() / sizeof(int32_t));
}

void ElementForces::evaluate(const Model& m, const Control* control, const Vec3f* q,
                             const Vec3f* qd) {
  auto& [spring, triangle, edge, tetrahedron] = tables_;
  const int32_t n = m.particle_count();
  spring.update(m.particle_spring_indices, n, "particle_spring_indices");
  triangle.update(m.particle_tri_indices, n, "particle_tri_indices");
  edge.update(m.particle_edge_indices, n, "particle_edge_indices", true);
  tetrahedron.update(m.particle_tet_indices, n, "particle_tet_indices");
  const auto& tri_activation =
      control != nullptr ? control->particle_tri_activation : m.particle_tri_activation;
  const auto& tet_activation =
      control != nullptr ? control->particle_tet_activation : m.particle_tet_activation;
  springs(m, q, qd, spring.forces);
  triangles(m, tri_activation.data(), q, qd, triangle.forces);
  edges(m, q, qd, edge.forces);
  tetrahedra(m, tet_activation.data(), q, qd, tetrahedron.forces);
}

void ElementForces::reset() {
  for (Table& table : tables_) table.rows.reset();
}

}  // namespace novaphy
