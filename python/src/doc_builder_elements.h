// Docstrings of ModelBuilder: particles, elements and meshes.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kAddSpring[] =
    R"(Adds a spring between two particles and returns its index. The rest length is the distance of
the particles at the call.

i, j: the indices of the particles.
ke, kd: stiffness (N/m) and damping (N*s/m).
control: a number that is stored; no force uses it.
tension_only: True makes a rope, which pulls when it is longer than its rest length, and never
pushes. SolverVBD and DiffSolverVBD support ropes. Other solvers raise an error for a rope.

ValueError: both particles have the same position.)";

inline constexpr char kAddEdge[] =
    R"(Adds a bending element on the edge from k to l between the triangles (i, k, l) and (j, l, k).
Returns the index.

i, j: the particles opposite to the edge. One of the two may be -1 at a border.
k, l: the particles of the edge.
rest: the dihedral angle at which no force acts (rad). None: the angle at the call.
edge_ke, edge_kd: bending stiffness (N/m^2) and damping (N*s/m^4); None: the builder's defaults.)";

inline constexpr char kAddTriangle[] =
    R"(Adds a membrane triangle between three particles. Returns its area (m^2).

i, j, k: the particles, counter-clockwise as seen from the front.
tri_ke: membrane stiffness (N/m).
tri_ka: area stiffness (N/m).
tri_kd: damping (N*s/m).
tri_drag, tri_lift: aerodynamic drag and lift (N*s^2/m^4).

None takes the builder's default, such as default_tri_ke.

ValueError: the area is at most 1e-7 of the square of the longest edge.)";

inline constexpr char kAddParticleGrid[] =
    R"(Adds dim_x * dim_y * dim_z particles on a grid. The index grows fastest along z, then along
x, then along y.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y, cell_z: the spacing of the particles (m).
mass: the mass of one particle (kg).
jitter: each coordinate of a particle gets a random offset of at most jitter / 2 (m).
radius_mean, radius_std: mean and standard deviation of the normal distribution of radii (m).
seed: the seed of offsets and radii.)";

inline constexpr char kAddClothGrid[] =
    R"(Adds a cloth of dim_x * dim_y cells, with two triangles per cell. The cloth lies in the plane
z = 0 of the frame given by pos and rot.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y: the size of a cell (m).
mass: the mass of every particle (kg).
reverse_winding: True cuts each cell along the other diagonal.
fix_left, fix_right: the particles at the smallest, or largest, x get mass 0 and are not ACTIVE.
fix_bottom, fix_top: the same for the smallest, or largest, y.
add_springs: adds springs along the edges of triangles, and across each edge.
spring_ke, spring_kd: stiffness (N/m) and damping (N*s/m) of the springs.
tri_ke, ...: see add_triangle. edge_ke, edge_kd: see add_edge.)";

inline constexpr char kAddSoftGrid[] =
    R"(Adds a soft block of dim_x * dim_y * dim_z cells with five tetrahedra per cell. The surface
gets triangles and bending edges.

pos, rot: the pose of the grid's origin (m, xyzw).
vel: the velocity of all particles (m/s).
cell_x, cell_y, cell_z: the size of a cell (m).
density: kg/m^3. Each corner of a cell gets an eighth of the mass of the cell.
fix_left, fix_right: the particles at the smallest, or largest, x get mass 0.
fix_bottom, fix_top: the same for the smallest, or largest, y.

For the materials see add_tetrahedron, add_triangle and add_edge.)";

inline constexpr char kAddClothMesh[] =
    R"(Adds a cloth from a triangle mesh.

pos, rot: the pose of the mesh's origin (m, xyzw).
scale: a factor for the vertices.
vel: the velocity of all particles (m/s).
vertices: positions (n, 3) (m), or a flat array.
indices: the vertices of the triangles (m, 3), or a flat array.
density: kg/m^2. Each corner gets a third of the mass of its triangle.

For the other arguments see add_cloth_grid.

ValueError: the mesh is empty, a vertex belongs to no triangle, a triangle is degenerate, or more
than two triangles share an edge.)";

inline constexpr char kAddSoftMesh[] =
    R"(Adds a soft body from a tetrahedral mesh.

pos, rot: the pose of the mesh's origin (m, xyzw).
scale: a factor for the vertices.
vel: the velocity of all particles (m/s).
vertices: positions (n, 3) (m), or a flat array.
indices: the vertices of the tetrahedra (m, 4), or a flat array.
mesh: an object with the attributes vertices and indices, and optionally density, k_mu, k_lambda and
k_damp. The attributes replace arguments that are None.
density: kg/m^3. Each corner gets a quarter of the mass of its tetrahedron.
youngs_modulus, poisson_ratio, k_mu, k_lambda, k_damp: see add_tetrahedron. Each is one number, or
one number for each tetrahedron. youngs_modulus replaces k_mu and k_lambda of the mesh.
tri_ke, ..., edge_kd: the materials of the surface, see add_triangle and add_edge.

ValueError: the mesh is empty, a vertex belongs to no tetrahedron, a tetrahedron is degenerate or
inverted, or more than two tetrahedra share a face.)";

inline constexpr char kColor[] =
    R"(Divides the particles into colors for SolverVBD: particles of the same element get different
colors. Call color after all elements are added. Elements are springs, triangles, tetrahedra and
bending edges.

include_bending: None or True: particles of a bending edge with a stiffness or damping get different
colors. False: they may share a color, but then a stiff edge converges slowly or not at all.
balance_colors: moves particles between colors until all colors have about the same size.)";

inline constexpr char kAddShapeMesh[] =
    R"(Adds a triangle mesh as a shape and returns its index. Vertices at the same position are
merged. Contacts of a mesh with other shapes are found on the CPU only.

vertices: positions (n, 3) (m), or a flat array.
indices: the vertices of the triangles (m, 3), or a flat array, counter-clockwise as seen from
outside.
mesh: an object with the attributes vertices and indices, which replace the arguments of the same
names.
scale: one factor, or a factor for each of x, y and z, > 0.

On a body, a mesh with a density > 0 must be closed, because the mass is the integral over its
volume. With cfg.is_solid=False the mass is that of a shell, whose wall of thickness cfg.margin is
inside of the surface.

ValueError: the mesh has no triangle, a triangle has a corner twice, or a position is not finite.
ValueError: a mesh that needs a mass is open or inside out.)";

inline constexpr char kAddShapeHull[] =
    R"(Adds the convex hull of points as a shape and returns its index.

vertices: positions (n, 3) (m).
mesh: an object with the attribute vertices, which replaces the argument of the same name.
scale: one factor, or a factor for each of x, y and z, > 0.
max_vertices: 4 to 64. A hull with more vertices keeps only the farthest max_vertices vertices. The
mass is that of the hull of all points, which is slightly larger.

ValueError: there are fewer than 4 points, all points are in one plane, or a position is not
finite.)";

inline constexpr char kAddTet[] =
    R"(Adds a tetrahedron between the particles i, j, k and l. Returns its volume (m^3).

youngs_modulus: Young's modulus (Pa, > 0).
poisson_ratio: Poisson's ratio, above -1 and below 0.5.
Both give a body the same small-strain elasticity in each solver. The model stores the Lame
parameters mu = E / (2 (1 + nu)) and lambda = 2 nu mu / (1 - 2 nu).
k_mu, k_lambda: coefficients (Pa) of the law, in place of youngs_modulus and poisson_ratio; None:
the builder's defaults, such as default_tet_k_mu. SolverVBD takes k_mu and k_lambda as Lame
parameters. SolverSemiImplicit takes them as coefficients of its law, as Newton does: the Lame
parameters are 3/4 k_mu and k_lambda - 5/8 k_mu there.
k_damp: damping (Pa*s); None: default_tet_k_damp.

ValueError: youngs_modulus or poisson_ratio is out of range, comes alone, or comes with k_mu or
k_lambda.
ValueError: the volume is at most 1e-7 of the cube of the longest edge, or the tetrahedron is
inverted.)";

inline constexpr char kAddTriangles[] =
    R"(Adds n triangles and returns their areas {n} (m^2).

i, j, k: lists {n} of particles.
tri_ke, ...: the materials of add_triangle, each one number, or a list with a number per
triangle.)";

}  // namespace novaphy::python::doc
