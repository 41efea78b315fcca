// CollisionPipeline: finds the contacts of a state.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "novaphy/collision/broad_phase.h"
#include "novaphy/collision/export.h"
#include "novaphy/collision/narrow_phase.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/rollout.h"

namespace novaphy {

namespace detail {
class RigidContacts;
class SoftContacts;
}  // namespace detail

struct CollisionOptions {
  BroadPhase broad_phase = BroadPhase::Explicit;
  NarrowPhase narrow_phase = NarrowPhase::Auto;
  // With BroadPhase::Explicit, the pairs of shapes to look at instead of
  // Model::shape_contact_pairs, whatever flags, groups, worlds and filters say.
  std::optional<std::vector<Vec2i>> shape_pairs_filtered = {};
  // Rows of the rigid contacts. When empty, as many as the candidate pairs can have, so that
  // nothing can overflow; but no more than 1000 or 64 per shape, whichever is larger.
  std::optional<int32_t> rigid_contact_max = {};
  // Rows of a pair of shapes, 8 or 4: the penalty stiffness of a face is that of its rows. Planes
  // with shapes have their own number, four for a box.
  int32_t contacts_per_pair = 8;
  // Slots of the contacts; as many as candidate pairs when empty, so that nothing can overflow.
  std::optional<int32_t> soft_contact_max = {};
  // m, finite and >= 0: contacts are made up to this distance between the surfaces. Newton 1.8
  // calls it soft_contact_gap.
  float soft_contact_margin = 0.01f;
  bool deterministic = true;  // contacts are always made in candidate order, also with false
  std::optional<bool> requires_grad = {};  // handed on to contacts(); the model's when empty
  // On the CPU, the first collide that finds contacts warns of overlaps (overlaps.h).
  bool warns_of_overlaps = true;
};

// Soft contacts: a record for every active particle and every shape with
// ShapeFlags.COLLIDE_PARTICLES, of one world or with one of both in all worlds (-1), whose distance
// d from the particle's center to the surface is
//   d < (soft_contact_margin + shape_margin) + particle_radius
// with the closest point of the surface and the normal there (collision/diff_soft_contact_trace.h).
// Planes, boxes, spheres, capsules, cylinders, cones, ellipsoids, convex hulls and meshes of the
// world and of bodies
// (geometry/point_distance.h; of a mesh, what is behind its nearest triangle is inside); others
// throw ErrorKind::NotImplemented. The geometry of a record carries no gradient. A particle whose
// position is NaN meets nothing.
//
// Rigid contacts: the points where two shapes touch or nearly do, of pairs of which at least one is
// on a body. Shape A is the one of the smaller GeoType; of two alike the one of the smaller index.
// The narrow phase gives a normal n from A to B and points with a signed distance (geometry/); a
// point is a row where
//   dot(b - a, n) - (radius_A + radius_B + margin_A + margin_B) <= gap_A + gap_B
// with the core points a, b of Contacts::rigid_contact_point0, point1. Covered are infinite planes
// with spheres, capsules, ellipsoids, cylinders, boxes (their four deepest corners), cones, convex
// hulls and meshes (up to four vertices), and all but meshes with each other (geometry/collide.h),
// up to eight points. On the CPU, meshes meet these and each other (geometry/mesh_pair.h): up to
// 32 points with normals of their own, ordered by distance, whose names may change when a point
// passes to another triangle. Candidates are Model::shape_contact_pairs (BroadPhase::Explicit), or
// the pairs that flags, groups and worlds of shapes now allow (NxN; Sap, which lists no others), of
// all three those whose boxes meet: the same rows. Sap finds its pairs by a tree of boxes on the
// device of the model (on the CPU by sweep and prune on the host, unless it is recorded). Outside
// of a recording it makes room for all of them; a recording has the room that there is, at least 16
// pairs for each shape, and each pair beyond counts as a row behind rigid_contact_max, so that the
// contacts have overflowed, with slots left empty at the end. Rows are in the order of (shape A,
// shape B, point of the manifold) for any number of threads. If there are more than
// rigid_contact_max, those stay that are within the largest part of the gaps of their pairs for
// which there is room (1/2, 1/4, ..., 1/1024, or what touches), and the first of those within the
// next larger part, so that no slot is empty. rigid_contact_count keeps the full number. Source:
// Newton 1.8.0; its rows on the cpu are the same bits for planes with spheres, capsules and boxes,
// but the order of pairs where shape A has the larger index.
//
// Candidate pairs (candidate_pairs.h) of soft contacts are ordered shape-major: the particles that
// may meet the first colliding shape, then those of the second, ... The contacts have that order
// for any number of threads. If there are more than slots, the first ones are kept,
// soft_contact_count keeps the full number and Contacts::overflowed() is true.
//
// One thread at a time may use a pipeline: another one gets ErrorKind::Runtime.
class NOVAPHY_COLLISION_API CollisionPipeline : public ContactFinder {
 public:
  // ErrorKind::Value: no model, a bad margin, a negative maximum, too many pairs for int32; pairs
  // with another broad phase, of two shapes of one body or of the world; ErrorKind::Index: of a
  // shape that is not there;
  // ErrorKind::NotImplemented: a narrow phase that the build lacks, two shapes that may meet and
  // are not covered, a model on a device whose collision was not built, a colliding shape that is
  // not covered.
  explicit CollisionPipeline(std::shared_ptr<const Model> model,
                             const CollisionOptions& options = {});

  const std::shared_ptr<const Model>& model() const { return model_; }
  BroadPhase broad_phase() const { return options_.broad_phase; }
  // Those of the options, each once, the smaller shape first, in ascending order.
  const std::optional<std::vector<Vec2i>>& shape_pairs_filtered() const {
    return options_.shape_pairs_filtered;
  }
  NarrowPhase narrow_phase() const { return options_.narrow_phase; }
  // With NarrowPhase::Fcl, over all calls so far: the pairs of hulls that overlap, and those of
  // them for which FCL's answer was not taken.
  int64_t fcl_pair_count() const;
  int64_t fcl_fallback_count() const;
  float soft_contact_margin() const { return options_.soft_contact_margin; }
  int32_t rigid_contact_max() const;        // rows of contacts()
  int32_t soft_contact_max() const;         // slots of contacts()
  int32_t soft_contact_pair_count() const;  // candidate_pairs.h

  // Empty contacts that collide takes; with true, rows may have materials of their own
  // (Contacts::rigid_contact_stiffness, ...), and no collide with them can be recorded.
  Contacts contacts() const override { return contacts(false); }
  Contacts contacts(bool per_contact_shape_properties) const;

  // Replaces the contacts by those of the state and raises contact_generation. May stand in a
  // capture: a replay finds the contacts of what the state then holds, and refuses once the flags,
  // types or bodies of shapes were written.
  // `soft_contact_margin` replaces the pipeline's for this call. `dt` (s) is that of the step that
  // takes the contacts: rows of rigid contacts that are farther apart than twice the way of their
  // shapes in it, and 4 m/s dt, are left out. Nothing is written after an error:
  //   ErrorKind::Value  a state or contacts of another model or device; contacts for another number
  //                     of candidate pairs (shape flags were edited: call contacts() again); a bad
  //                     margin; dt not finite or <= 0; without dt, and unless it is
  //                     recorded, check_rotations (input_checks.h)
  //   ErrorKind::Index  a world of a particle, body or shape that is not there
  //   ErrorKind::NotImplemented  a colliding shape that is not covered
  //   ErrorKind::Runtime         NarrowPhase::Fcl is recorded; NotImplemented: so is Sap, with
  //   meshes
  void collide(const SimState& state, Contacts& contacts,
               std::optional<float> soft_contact_margin = {},
               std::optional<float> dt = {}) override;

 private:
  int32_t count_pairs() const;  // within a use
  void warn_of_overlaps(const SimState& state, const Contacts& contacts);

  std::shared_ptr<const Model> model_;
  CollisionOptions options_;
  bool has_looked_for_overlaps_ = false;
  std::shared_ptr<detail::SoftContacts> soft_contacts_;
  std::shared_ptr<detail::RigidContacts> rigid_contacts_;
  std::shared_ptr<ExclusiveUse> in_use_ = std::make_shared<ExclusiveUse>();  // of both
};

}  // namespace novaphy
