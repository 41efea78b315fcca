// Docstrings of CollisionPipeline.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kPipeline[] =
    R"(Finds contacts of particles with shapes (soft) and of shapes with each other (rigid). The
geometry of both carries no gradient.

A soft contact is a record for each active particle whose center is closer to a shape than
soft_contact_margin + shape_margin + particle_radius, in candidate order. Shapes of the world and of
bodies count: planes, boxes, spheres, capsules, cylinders, cones, ellipsoids, convex hulls and
meshes.

Rigid contacts are rows of the points of two shapes, at least one of them on a body, that are closer
than both gaps. The rows are ordered by shape0, shape1, point. Shapes are infinite planes, spheres,
capsules, ellipsoids, cylinders, boxes, cones, convex hulls and, on the CPU, meshes, which also meet
meshes.)";

inline constexpr char kPipelineInit[] =
    R"(Makes a pipeline for a model.

broad_phase: "explicit" takes the pairs of model.shape_contact_pairs, or shape_pairs_filtered
(n, 2), whatever flags, groups, worlds and filters say. "nxn" takes the pairs that flags, groups and
worlds of shapes now allow. "sap" takes the same pairs by sweep and prune. All give the same rows.
In a capture or on a tape "sap" has room for 16 pairs of each shape. After an earlier collide with
more pairs, the room is the number of these pairs plus a quarter.
narrow_phase: "auto", or "fcl" in builds with NOVAPHY_WITH_FCL. FCL then computes depth and normal
of overlapping convex hulls. A result of FCL that is not consistent is replaced by that of "auto".
rigid_contact_max: the number of rows. None: as many as the pairs can have, but at most 1000 or 64
per shape.
contacts_per_pair: 8 or 4; the most contacts of two shapes of which none is a plane.
soft_contact_max: the number of slots. None: as many as candidate pairs.
soft_contact_margin: m, 0.01 by default; soft_contact_gap is another name for it.
reduce_contacts: True. Contacts of meshes are always reduced, so False is not supported.)";

inline constexpr char kContacts[] =
    R"(Returns empty contacts, which collide fills.

per_contact_shape_properties: rows may have a rigid_contact_stiffness, _damping and _friction of
their own. Write them after each collide, which sets them to 0. Such a collide cannot be captured.)";

inline constexpr char kCollide[] =
    R"(Replaces the contacts by those of the state.

soft_contact_margin: m, for this call.
dt: s, of the step that takes the contacts. Rigid contacts that are too far apart to touch within
the step are left out.

ValueError: a state or contacts of another model or device, a bad margin or dt. Nothing is written
then.)";

inline constexpr char kFilteredPairs[] =
    R"(The shape pairs (i < j) that are tested, ascending. None: the pairs of
model.shape_contact_pairs.)";

inline constexpr char kFclPairs[] =
    R"(The number of overlapping pairs of hulls so far, with narrow_phase "fcl".)";

}  // namespace novaphy::python::doc
