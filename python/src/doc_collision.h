// Docstrings of CollisionPipeline.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kPipeline[] =
    R"(Finds contacts of particles with shapes (soft contacts) and of shapes with each other (rigid
contacts). The positions and normals of contacts carry no gradient.

A soft contact is recorded for each active particle whose center is closer to the surface of a shape
than soft_contact_margin + shape_margin + particle_radius. The contacts are in the order of the
candidate pairs. The shapes may belong to the world or to bodies. Supported are planes, boxes,
spheres, capsules, cylinders, cones, ellipsoids, convex hulls and meshes.

A rigid contact is a row for a point where two shapes are closer than the sum of their gaps. At
least one of the shapes is on a body. The rows are ordered by shape0, shape1 and point. Supported
are infinite planes, spheres, capsules, ellipsoids, cylinders, boxes, cones, convex hulls and
meshes, which also meet meshes.)";

inline constexpr char kPipelineInit[] =
    R"(Makes a pipeline for a model.

broad_phase: how candidate pairs of shapes are found. All three give the same rows.

  "explicit": the pairs of model.shape_contact_pairs, or the pairs shape_pairs_filtered (n, 2) if
  given. Later changes of flags, groups, worlds and filters have no effect.
  "nxn": all pairs that the present flags, groups and worlds of shapes allow.
  "sap": the same pairs as "nxn", found by sweep and prune. In a capture or on a tape there is room
  for 16 pairs per shape. If an earlier collide found more pairs, there is room for 1.25 times as
  many.

narrow_phase: "auto", or "fcl" in builds with NOVAPHY_WITH_FCL. FCL then computes depth and normal
of overlapping convex hulls. If a result of FCL is not consistent, that of "auto" is used.
rigid_contact_max: the number of rows. None: as many as the pairs can have, but at most 1000 or 64
per shape, whichever is more.
contacts_per_pair: 8 or 4, the largest number of contacts of two shapes, if none of them is a plane.
soft_contact_max: the number of slots. None: the number of candidate pairs.
soft_contact_margin: m; None: 0.01. soft_contact_gap is another name of this argument.
deterministic: no effect, because contacts always have the same order. Newton has this argument.
reduce_contacts: True. Contacts of meshes are always reduced, so False is not supported.)";

inline constexpr char kContacts[] =
    R"(Returns empty Contacts with the capacities of this pipeline. collide fills them.

per_contact_shape_properties: True adds arrays for a material of each row: rigid_contact_stiffness,
rigid_contact_damping and rigid_contact_friction. collide sets them to 0, so write them after each
collide. A collide into such contacts cannot be captured.)";

inline constexpr char kCollide[] =
    R"(Finds the contacts of a state and writes them into `contacts`, in place of earlier contacts.

soft_contact_margin: m, for this call only; None: the margin of the pipeline.
dt: the length (s) of the step that will use the contacts. Rigid contacts that are too far apart to
touch within the step are left out. None: all contacts are kept.

ValueError, before anything is written: the state or the contacts belong to another model or device,
or the margin or dt is not valid.)";

inline constexpr char kFilteredPairs[] =
    R"(The list of shape pairs (i, j), i < j, that broad_phase "explicit" tests, in ascending order.
None: the pairs of model.shape_contact_pairs.)";

inline constexpr char kFclPairs[] =
    R"(The number of overlapping pairs of hulls that narrow_phase "fcl" has tested since the
start.)";

inline constexpr char kFclFallbacks[] =
    R"(The number of pairs in fcl_pair_count for which the result of FCL was not consistent, so that
the result of "auto" was used.)";

}  // namespace novaphy::python::doc
