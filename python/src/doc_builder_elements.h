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
rest: the angle without a force (rad); None: the present angle.)";

inline constexpr char kAddSoftMesh[] =
    R"(Adds a soft body from a tetrahedral mesh.

vertices, indices: arrays of shape (n, 3) and (m, 4), or flat arrays.
mesh: an object that replaces both, with the attributes vertices, indices, density, k_mu, k_lambda
and k_damp.
density: kg/m^3. Each corner gets a quarter of the mass of its tetrahedron.
k_mu, k_lambda (Pa), k_damp (Pa s): one number, or one number for each tetrahedron.

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

}  // namespace novaphy::python::doc
