// Options of the ModelBuilder functions that add springs, triangles, bending edges, tetrahedra, and
// whole grids and meshes of them.
//
// An empty optional means the builder's default (ModelBuilder::default_tri_ke and so on). Materials
// are finite and >= 0. Sizes, densities and scales are double, so that a product of them is rounded
// once.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "novaphy/math/types.h"

namespace novaphy {

// Of a triangle: membrane, area and damping stiffness, aerodynamic drag and lift.
struct TriMaterial {
  std::optional<float> ke = {}, ka = {}, kd = {}, drag = {}, lift = {};
};
// Of a bending edge: stiffness and damping.
struct EdgeMaterial {
  std::optional<float> ke = {}, kd = {};
};

// Where a grid or mesh goes: x_world = pos + rotate(rot, x).
struct Placement {
  Vec3f pos{};                    // m
  Quatf rot = Quatf::identity();  // of unit length (to 1e-3)
  Vec3f vel{};                    // m/s, of every particle
};

// dim_x * dim_y * dim_z particles. Newton's order: y slowest, then x, then z.
struct ParticleGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1, dim_z = 1;          // particles, >= 0
  double cell_x = 0.1, cell_y = 0.1, cell_z = 0.1;  // m, distance of neighbors
  float mass = 1.0f;                                // kg, of one particle
  double jitter = 0.0;                              // m: each coordinate moves by up to half of it
  std::optional<float> radius_mean = {};            // m
  double radius_std = 0.0;                          // m, normally distributed; cut at 0
  uint64_t seed = 0;                                // of jitter and radii
};

// (dim_x + 1) * (dim_y + 1) particles, x fastest, in the local plane z = 0; two triangles per cell.
struct ClothGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1;       // cells, >= 1
  double cell_x = 0.1, cell_y = 0.1;  // m
  float mass = 1.0f;                  // kg, of every particle
  bool reverse_winding = false;       // the other diagonal of each cell
  // Particles at the ends of x (left, right) and y (bottom, top): mass 0, not active.
  bool fix_left = false, fix_right = false, fix_top = false, fix_bottom = false;
  TriMaterial tri = {};
  EdgeMaterial edge = {};
  bool add_springs = false;  // along edges and across them
  std::optional<float> spring_ke = {}, spring_kd = {};
  std::optional<float> particle_radius = {};
};

// A triangle mesh; a third of density * area goes to each corner.
struct ClothMeshArgs {
  Placement placement = {};
  double scale = 1.0;  // > 0
  std::span<const Vec3f> vertices = {};
  std::span<const int32_t> indices = {};  // 3 per triangle
  double density = 1.0;                   // kg/m^2, >= 0
  TriMaterial tri = {};
  EdgeMaterial edge = {};
  bool add_springs = false;
  std::optional<float> spring_ke = {}, spring_kd = {};
  std::optional<float> particle_radius = {};
};

// (dim_x + 1) * (dim_y + 1) * (dim_z + 1) particles, x fastest, then y; five tetrahedra per cell;
// the faces on the surface as triangles, their edges as bending edges.
struct SoftGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1, dim_z = 1;          // cells, >= 1
  double cell_x = 0.1, cell_y = 0.1, cell_z = 0.1;  // m
  // kg/m^3. Newton's rule: every particle, inside or on the surface, has the mass of one cell.
  double density = 1.0;
  std::optional<float> k_mu = {}, k_lambda = {}, k_damp = {};  // Pa, Pa, Pa*s
  // Particles at the ends of x (left, right) and y (bottom, top) get mass 0.
  bool fix_left = false, fix_right = false, fix_top = false, fix_bottom = false;
  TriMaterial tri = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  bool add_surface_mesh_edges = true;
  EdgeMaterial edge = {0.0f, 0.0f};
  std::optional<float> particle_radius = {};
};

// A tetrahedral mesh; a quarter of density * volume goes to each corner. Surface as in a grid.
struct SoftMeshArgs {
  Placement placement = {};
  double scale = 1.0;  // > 0
  std::span<const Vec3f> vertices = {};
  std::span<const int32_t> indices = {};  // 4 per tetrahedron, of positive volume
  std::optional<double> density = {};     // kg/m^3, >= 0; empty: default_tet_density
  std::span<const float> k_mu = {}, k_lambda = {}, k_damp = {};  // none, one, or one each
  TriMaterial tri = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  bool add_surface_mesh_edges = true;
  EdgeMaterial edge = {0.0f, 0.0f};
  std::optional<float> particle_radius = {};
};

}  // namespace novaphy
