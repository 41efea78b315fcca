// Docstrings of ModelBuilder: particles, elements and meshes.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddSpring[] =
    R"(Adds a spring between two particles, at rest at their present distance. Returns the index.

ke, kd: stiffness (N/m) and damping (N*s/m).
control: stored; no force uses it.
tension_only: a rope, which pulls where it is longer than at rest, and never pushes. SolverVBD and
DiffSolverVBD step ropes; other solvers refuse them.

ValueError: both particles are in one place.)";

inline constexpr char kAddEdge[] =
    R"(Adds a bending edge from k to l between the triangles (i, k, l) and (j, l, k). Returns the
index.

i, j: the opposite corners; one of them may be -1.
rest: the angle without a force (rad); None: the present angle.
edge_ke, edge_kd: bending stiffness (N/m^2) and damping (N*s/m^4); None: the builder's defaults.)";

inline constexpr char kAddTriangle[] =
    R"(Adds a triangle with counter-clockwise corners i, j, k. Returns its area (m^2).

tri_ke, tri_ka: stiffness of the membrane and of the area (N/m).
tri_kd: damping (N*s/m).
tri_drag, tri_lift: aerodynamic drag and lift (N*s^2/m^4).

None takes the builder's default, such as default_tri_ke.

ValueError: the area is at most 1e-7 of the square of the longest edge.)";

inline constexpr char kAddParticleGrid[] =
    R"(Adds dim_x * dim_y * dim_z particles in a grid: y slowest, then x, then z.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y, cell_z: the spacing of the particles (m).
mass: the mass of one particle (kg).
jitter: m; each coordinate moves at random by at most half of this.
radius_mean, radius_std: the normal distribution of the radii (m).
seed: the seed of jitter and radii.)";

inline constexpr char kAddClothGrid[] =
    R"(Adds a cloth of dim_x * dim_y cells, two triangles each, in the plane z = 0 of the pose.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y: the size of a cell (m).
mass: the mass of every particle (kg).
reverse_winding: cuts each cell along the other diagonal.
fix_left, fix_right: the ends of x get mass 0 and are not active.
fix_bottom, fix_top: likewise the ends of y.
add_springs: adds springs along the edges and across them.
spring_ke, spring_kd: N/m and N*s/m. Other materials are those of add_triangle and add_edge.)";

inline constexpr char kAddSoftGrid[] =
    R"(Adds a block of dim_x * dim_y * dim_z cells, five tetrahedra each, with triangles and
bending edges on the surface.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y, cell_z: the size of a cell (m).
density: kg/m^3. Every particle has the mass of one cell.
fix_left, fix_right: the ends of x get mass 0.
fix_bottom, fix_top: likewise the ends of y.

Materials are those of add_tetrahedron, add_triangle and add_edge.)";

inline constexpr char kAddClothMesh[] =
    R"(Adds a cloth from a triangle mesh.

pos, rot: the pose of the mesh's origin (m, xyzw).
scale: a factor of the vertices.
vel: the velocity of all particles (m/s).
vertices, indices: arrays of shape (n, 3) (m) and (m, 3), or flat arrays.
density: kg/m^2. Each corner gets a third of the mass of its triangle.

Other arguments are those of add_cloth_grid.

ValueError: the mesh is empty, a vertex belongs to no triangle, a triangle is degenerate, or more
than two triangles share an edge.)";

inline constexpr char kAddSoftMesh[] =
    R"(Adds a soft body from a tetrahedral mesh.

pos, rot: the pose of the mesh's origin (m, xyzw).
scale: a factor of the vertices.
vel: the velocity of all particles (m/s).
vertices, indices: arrays of shape (n, 3) (m) and (m, 4), or flat arrays.
mesh: an object that replaces both, with the attributes vertices, indices, density, k_mu, k_lambda
and k_damp.
density: kg/m^3. Each corner gets a quarter of the mass of its tetrahedron.
k_mu, k_lambda (Pa), k_damp (Pa*s): one number, or one number for each tetrahedron.
The materials of the surface are those of add_triangle and add_edge.

ValueError: the mesh is empty, a vertex belongs to no tetrahedron, a tetrahedron is degenerate or
inverted, or more than two tetrahedra share a face.)";

inline constexpr char kColor[] =
    R"(Colors the particles for SolverVBD, so that the particles of an element have different
colors. Call it after the elements are added. Elements are springs, triangles, tetrahedra and
bending edges.

include_bending: None or True: bending edges with a stiffness or damping count. False: the corners
of a bending edge may share a color, with which a stiff edge converges badly or not at all.
balance_colors: moves particles between colors until all are about equally large.)";

inline constexpr char kAddShapeMesh[] =
    R"(Adds a surface of triangles. Returns the index. Vertices in one place count as one. Contacts
with bodies are found on the CPU.

vertices, indices: arrays of shape (n, 3) (m) and (m, 3), or flat. The corners are counter-clockwise
as seen from outside.
mesh: an object with these two as attributes.
scale: a number or three, > 0.

A surface on a body, with a density, must be closed. Its mass is an integral in double precision. A
shell (cfg.is_solid False) has a wall of cfg.margin inside.

ValueError: no triangle, a corner twice, not finite, open or inside out.)";

inline constexpr char kAddShapeHull[] =
    R"(Adds the convex hull of points. Returns the index.

vertices: an array of shape (n, 3) (m). mesh: an object with this attribute.
scale: a number or three, > 0.
max_vertices: 4 to 64; the hull keeps at most so many, the farthest ones. The mass is that of the
hull of all points, which is a little larger.

ValueError: fewer than 4 points, points in one plane, also once they are scaled, not finite.)";

inline constexpr char kAddTet[] =
    R"(Adds a tetrahedron with the Lame parameters k_mu, k_lambda (Pa) and the damping k_damp
(Pa*s). Returns its volume (m^3). ValueError: the volume is at most 1e-7 of the cube of the longest
edge, or the tetrahedron is inverted.)";

inline constexpr char kAddTriangles[] =
    R"(Adds many triangles from three lists of particles. A material of add_triangle is one number,
or a list with one number for each triangle. Returns the areas (m^2).)";

}  // namespace novaphy::python::doc
