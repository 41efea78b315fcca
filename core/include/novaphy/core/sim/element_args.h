// Options of the ModelBuilder functions that add springs, triangles, bending edges and tetrahedra,
// or whole grids and meshes.
//
// An empty optional selects the builder's default (for example ModelBuilder::default_tri_ke).
// Materials are finite and >= 0. Sizes, densities and scales are double, so that a product of them
// is rounded once.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "novaphy/math/types.h"

namespace novaphy {

// Material of a triangle: membrane stiffness, area stiffness, damping, aerodynamic drag and lift.
struct TriMaterial {
  std::optional<float> ke = {}, ka = {}, kd = {}, drag = {}, lift = {};
};
// Material of a bending edge: stiffness and damping.
struct EdgeMaterial {
  std::optional<float> ke = {}, kd = {};
};

// Pose of a grid or mesh: x_world = pos + rotate(rot, x).
struct Placement {
  Vec3f pos{};                    // m
  Quatf rot = Quatf::identity();  // unit length (to 1e-3)
  Vec3f vel{};                    // m/s, initial velocity of every particle
};

// A grid of dim_x * dim_y * dim_z particles. The order of particles is that of the engine Newton: y
// varies slowest, then x, then z.
struct ParticleGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1, dim_z = 1;          // particles, >= 0
  double cell_x = 0.1, cell_y = 0.1, cell_z = 0.1;  // m, spacing of particles
  float mass = 1.0f;                                // kg, of one particle
  double jitter = 0.0;                              // m, each coordinate moves at random by at most
                                                    // half of this
  std::optional<float> radius_mean = {};            // m
  double radius_std = 0.0;                          // m, standard deviation of a normal
                                                    // distribution; radii are at least 0
  uint64_t seed = 0;                                // seed of jitter and radii
};

// A grid of (dim_x + 1) * (dim_y + 1) particles in the local plane z = 0, x fastest, with two
// triangles per cell.
struct ClothGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1;       // cells, >= 1
  double cell_x = 0.1, cell_y = 0.1;  // m
  float mass = 1.0f;                  // kg, of every particle
  bool reverse_winding = false;       // cuts each cell along the other diagonal
  // Makes the particles at the ends of x (left, right) and y (bottom, top) kinematic: mass 0, not
  // active.
  bool fix_left = false, fix_right = false, fix_top = false, fix_bottom = false;
  TriMaterial tri = {};
  EdgeMaterial edge = {};
  bool add_springs = false;  // springs on edges, and across each edge between the opposite corners
  std::optional<float> spring_ke = {}, spring_kd = {};
  std::optional<float> particle_radius = {};
};

// A triangle mesh. Each corner of a triangle gets a third of density * area.
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

// Materials of tetrahedra. Each span is empty, or has one value, or one value per tetrahedron.
struct TetMaterials {
  // Pa, Pa, Pa*s, >= 0; empty: the builder's defaults. SolverVBD takes k_mu and k_lambda as Lame
  // parameters, SolverSemiImplicit as coefficients of its law (Model::particle_tet_is_lame).
  std::span<const float> k_mu = {}, k_lambda = {}, k_damp = {};
  // Young's modulus (Pa, > 0) and Poisson's ratio (above -1, below 0.5), in place of k_mu and
  // k_lambda. The elasticity is then the same in each solver.
  std::span<const float> youngs_modulus = {}, poisson_ratio = {};
};

// Returns a view of the value, empty if there is none.
inline std::span<const float> one_of(const std::optional<float>& value) {
  return value ? std::span<const float>(&*value, 1) : std::span<const float>();
}

// A grid of (dim_x + 1) * (dim_y + 1) * (dim_z + 1) particles, x fastest, then y. Each cell has
// five tetrahedra. Triangles cover the surface, and their edges are bending edges.
struct SoftGridArgs {
  Placement placement = {};
  int32_t dim_x = 1, dim_y = 1, dim_z = 1;          // cells, >= 1
  double cell_x = 0.1, cell_y = 0.1, cell_z = 0.1;  // m
  // kg/m^3. Each corner of a cell gets an eighth of the mass of the cell.
  double density = 1.0;
  std::optional<float> k_mu = {}, k_lambda = {}, k_damp = {};  // see TetMaterials
  std::optional<float> youngs_modulus = {}, poisson_ratio = {};
  // Gives the particles at the ends of x (left, right) and y (bottom, top) mass 0.
  bool fix_left = false, fix_right = false, fix_top = false, fix_bottom = false;
  TriMaterial tri = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  bool add_surface_mesh_edges = true;
  EdgeMaterial edge = {0.0f, 0.0f};
  std::optional<float> particle_radius = {};
};

// A tetrahedral mesh. Each corner of a tetrahedron gets a quarter of density * volume. Triangles
// and bending edges cover the surface as in SoftGridArgs.
struct SoftMeshArgs {
  Placement placement = {};
  double scale = 1.0;  // > 0
  std::span<const Vec3f> vertices = {};
  std::span<const int32_t> indices = {};  // 4 per tetrahedron, of positive volume
  std::optional<double> density = {};     // kg/m^3, >= 0; empty: default_tet_density
  TetMaterials material = {};
  TriMaterial tri = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
  bool add_surface_mesh_edges = true;
  EdgeMaterial edge = {0.0f, 0.0f};
  std::optional<float> particle_radius = {};
};

}  // namespace novaphy
