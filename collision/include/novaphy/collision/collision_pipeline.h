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
  // With BroadPhase::Explicit: pairs that replace Model::shape_contact_pairs. Flags, groups, worlds
  // and filters of the shapes do not restrict them.
  std::optional<std::vector<Vec2i>> shape_pairs_filtered = {};
  // Number of rows for rigid contacts. Empty: the largest number of rows that the candidate pairs
  // can have, but at most max(1000, 64 times the number of shapes).
  std::optional<int32_t> rigid_contact_max = {};
  // Largest number of rows of a pair of shapes, 8 or 4. Each row has the penalty stiffness, so that
  // a face with more rows is stiffer. Pairs with a plane have a fixed number, for example four for
  // a box.
  int32_t contacts_per_pair = 8;
  // Number of slots for soft contacts. Empty: the number of candidate pairs, so that contacts
  // cannot overflow.
  std::optional<int32_t> soft_contact_max = {};
  // m, finite and >= 0: largest distance between the surfaces of a soft contact. Newton 1.8 has the
  // name soft_contact_gap for this value.
  float soft_contact_margin = 0.01f;
  // Has no effect, because contacts have the same order in every run. The option exists for code
  // that was written for Newton.
  bool deterministic = true;
  std::optional<bool> requires_grad = {};  // for contacts(); empty: the model's setting
  // Whether the first collide() that finds contacts warns of initial overlaps (overlaps.h). Applies
  // on the CPU.
  bool warns_of_overlaps = true;
};

// Soft contacts. A contact exists between an active particle and a shape with
// ShapeFlags.COLLIDE_PARTICLES of a compatible world if the particle is near. The distance d from
// the particle's center to the surface then is
//   d < (soft_contact_margin + shape_margin) + particle_radius
// The contact has the closest point of the surface and the normal at this point
// (collision/diff_soft_contact_trace.h), without a gradient.
//
// Supported shapes, of the world and of bodies: planes, boxes, spheres, capsules, cylinders, cones,
// ellipsoids, convex hulls and meshes (geometry/point_distance.h). A point behind the nearest
// triangle of a mesh is inside. Other shapes throw ErrorKind::NotImplemented. A particle whose
// position is NaN has no contacts.
//
// Rigid contacts. A contact is a point where two shapes touch or nearly touch. At least one shape
// belongs to a body. Shape A has the smaller GeoType, or the smaller index for equal types. The
// narrow phase (geometry/) gives a normal n from A to B and points with a signed distance. A point
// becomes a row of Contacts if
//   dot(b - a, n) - (radius_A + radius_B + margin_A + margin_B) <= gap_A + gap_B
// with the core points a, b (Contacts::rigid_contact_point0, point1). Supported pairs:
//   - infinite planes with spheres, capsules, ellipsoids, cylinders, boxes (their four deepest
//     corners), cones, convex hulls and meshes (up to four vertices)
//   - all other convex shapes with each other (geometry/collide.h), up to eight points
//   - meshes with convex shapes and with each other (geometry/mesh_pair.h), up to 32 points, each
//     with its own normal, ordered by distance. The id of a point may change when the point moves
//     to another triangle. On devices Sap refuses meshes.
//
// The candidate pairs are Model::shape_contact_pairs (Explicit), or the pairs that flags, groups
// and worlds currently allow (NxN and Sap). All three broad phases keep the pairs whose boxes
// overlap, and give the same rows. Sap uses a tree of boxes on the device of the model. On the CPU,
// outside of recordings, Sap is sweep and prune on the host.
//
// Outside of recordings the list of pairs grows as needed. A recording has a list of fixed size, at
// least 16 pairs for each shape. Each pair that does not fit counts as a row beyond
// rigid_contact_max. The contacts then overflow, and the last slots stay empty.
//
// Rows are sorted by shape A, shape B and point of the manifold, for any number of threads. If more
// than rigid_contact_max rows exist, the pipeline keeps the nearest ones. It chooses the largest
// fraction of each pair's gap (1/2, 1/4, ..., 1/1024, 0) for which all rows fit. The first rows
// within the next larger fraction fill the remaining slots. rigid_contact_count has the full
// number.
//
// Source: Newton 1.8.0. Newton's rows on the CPU have the same bits for planes with spheres,
// capsules and boxes. Only the order differs for pairs in which shape A has the larger index.
//
// Soft contacts have the order of candidate_pairs.h for any number of threads. If there are more
// contacts than slots, the first ones are kept, soft_contact_count has the full number, and
// Contacts::overflowed() is true.
//
// Only one thread at a time may use a pipeline. A second thread gets ErrorKind::Runtime.
class NOVAPHY_COLLISION_API CollisionPipeline : public ContactFinder {
 public:
  // Makes a pipeline. Errors:
  //   ErrorKind::Value           no model, a bad margin, a negative maximum, too many pairs for
  //                              int32; shape pairs with another broad phase, or of two shapes of
  //                              one body or of the world
  //   ErrorKind::Index           a pair with a shape that does not exist
  //   ErrorKind::NotImplemented  a narrow phase that the build lacks, a pair of shapes that may
  //                              touch and is not supported, a colliding shape that is not
  //                              supported, a model on a device without collision in the build
  explicit CollisionPipeline(std::shared_ptr<const Model> model,
                             const CollisionOptions& options = {});

  const std::shared_ptr<const Model>& model() const { return model_; }
  BroadPhase broad_phase() const { return options_.broad_phase; }
  // Returns the explicit pairs of the options without duplicates, with the smaller shape first, in
  // ascending order.
  const std::optional<std::vector<Vec2i>>& shape_pairs_filtered() const {
    return options_.shape_pairs_filtered;
  }
  NarrowPhase narrow_phase() const { return options_.narrow_phase; }
  // Counts over all calls with NarrowPhase::Fcl: overlapping pairs of hulls, and pairs whose FCL
  // result was rejected.
  int64_t fcl_pair_count() const;
  int64_t fcl_fallback_count() const;
  float soft_contact_margin() const { return options_.soft_contact_margin; }
  int32_t rigid_contact_max() const;        // rows of contacts()
  int32_t soft_contact_max() const;         // slots of contacts()
  int32_t soft_contact_pair_count() const;  // number of candidate pairs

  // Returns empty contacts for collide(). If the argument is true, the contacts also have arrays
  // for materials of single rows (Contacts::rigid_contact_stiffness and others). A call of
  // collide() with them cannot be recorded.
  Contacts contacts() const override { return contacts(false); }
  Contacts contacts(bool per_contact_shape_properties) const;

  // Replaces the contacts by the contacts of `state`, and increases contact_generation. A capture
  // may record the search. A replay then finds the contacts of the state at replay time, and throws
  // if flags, types or bodies of shapes were written. `soft_contact_margin` (m) replaces the
  // pipeline's value for this call. `dt` (s) is the step for which the contacts are used. With dt
  // the search removes rigid contacts whose distance exceeds 4 m/s dt plus twice the path of their
  // shapes in the step. Errors, after which nothing is written:
  //   ErrorKind::Value           a state or contacts of another model or device; contacts for
  //                              another number of candidate pairs (after an edit of shape flags,
  //                              call contacts() again); a bad margin; dt not finite or <= 0.
  //                              Without dt and outside of recordings also the errors of
  //                              check_rotations (input_checks.h)
  //   ErrorKind::Index           a particle, body or shape has a world that does not exist
  //   ErrorKind::NotImplemented  a colliding shape that is not supported; recording Sap with meshes
  //   ErrorKind::Runtime         recording NarrowPhase::Fcl
  void collide(const SimState& state, Contacts& contacts,
               std::optional<float> soft_contact_margin = {},
               std::optional<float> dt = {}) override;

 private:
  int32_t count_pairs() const;  // requires that the pipeline is in use
  void warn_of_overlaps(const SimState& state, const Contacts& contacts);

  std::shared_ptr<const Model> model_;
  CollisionOptions options_;
  bool has_looked_for_overlaps_ = false;
  std::shared_ptr<detail::SoftContacts> soft_contacts_;
  std::shared_ptr<detail::RigidContacts> rigid_contacts_;
  // guards the searches for contacts against a second thread
  std::shared_ptr<ExclusiveUse> in_use_ = std::make_shared<ExclusiveUse>();
};

}  // namespace novaphy
