// Self-contact in a step of VBD, on the host: pairs of features (collision/surface_pairs.h), their
// forces (self_contact_law.h), and bounds that keep the surfaces from crossing.
//
// A detection of pairs takes the current positions as origins. Until the next detection a particle
// stays within a distance of its origin, its reach. A pair that is farther apart than both reaches
// cannot cross. Every other pair has a plane between its two features, and no particle of the pair
// passes this plane.
//
// If a plane stopped a particle, the next iteration computes new planes for the pairs of this
// particle. If the end of its reach stopped a particle, its world gets a new detection. Each world
// has at most kDetections detections in a step.
#pragma once

#include <cmath>
#include <memory>
#include <span>
#include <vector>

#include "color_slots.h"
#include "novaphy/collision/geometry/nearest_weights.h"
#include "novaphy/collision/surface_pairs.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/vbd/self_contact_law.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy::vbd {

inline double wide(float v) { return static_cast<double>(v); }
inline Vec3<double> wide(const Vec4f& v) { return {wide(v.x), wide(v.y), wide(v.z)}; }
inline float narrow(double v) { return static_cast<float>(v); }
inline Vec3f narrow(const Vec3<double>& v) { return {narrow(v.x), narrow(v.y), narrow(v.z)}; }
inline Vec4f narrow_row(const Vec3<double>& v) {
  return {narrow(v.x), narrow(v.y), narrow(v.z), 0.0f};
}
inline double length_of(const Vec3<double>& v) { return std::sqrt(math::dot(v, v)); }
inline size_t index(int32_t i) { return static_cast<size_t>(i); }

class SelfContact {
 public:
  static constexpr int kDetections = 5;

  // The memory of a step, one row for each particle, and the scalars of the step.
  struct Rows {
    std::span<const Vec4f> start, target;
    std::span<Vec4f> moved, x;
    float h = 0.0f;     // s
    float slip = 0.0f;  // m, eps of particle_contact_law.h
  };
  // The contacts of particles with shapes (see VbdSweepArguments). Null: no contacts.
  struct Given {
    const int32_t* begin = nullptr;
    const float* numbers = nullptr;
  };

  // `model`: on the host. ErrorKind::Value: the model has no triangles, particles have several
  // radii and the options have none, or the radius is above the length of the shortest edge.
  SelfContact(const Model& model, const ColorSlots& slots, const VbdSelfContact& options);

  // Detects pairs at the start of a step, and moves the particles towards the initial guess as far
  // as the bounds allow. ErrorKind::Value, with the pair: surfaces cross or touch at the start.
  void begin(const Rows& rows);
  // Computes new bounds for particles that a bound stopped.
  void detect_again();
  // Finds the contacts at the positions x, with their weights and normals.
  void find_contacts(const Given& given);
  // Computes the stored values of the contacts of some groups' particles, at the positions x.
  void put_numbers(int64_t first_group, int64_t end_group);
  // Moves the particles of some groups back into their bounds.
  void hold(int64_t first_group, int64_t end_group);
  // Moves free components that touched each other by a common translation. Together they then have
  // the momentum that gravity and the external forces give.
  void balance(const Given& given);
  // Ends the step. ErrorKind::Runtime: a kinematic particle would cross a surface on its way.
  void end();

  VbdSelfContacts contacts() const;
  // The contacts of particles with surfaces and with shapes, as arguments of VbdSweepArguments.
  const DeviceArray<int32_t>& begins() const { return begins_; }
  const DeviceArray<float>& numbers() const { return numbers_; }

 private:
  using Vec3d = geometry::Vec3d;
  // A plane that separates the two features of a pair: the points x with dot(normal, x) = offset.
  // The first feature lies where dot(normal, x) exceeds the offset.
  struct Plane {
    Vec3d normal{};
    double offset = 0.0;
    // Returns the distance (m) of a point from the plane, positive above the plane.
    double height(const Vec3d& x) const { return math::dot(normal, x) - offset; }
  };
  struct Contact {
    size_t pair;
    Vec3d normal;
    double weight[4], gap;
    float factor, load;  // (2 - s) s of self_contact_law.h; load (N) at iteration start
  };

  Vec3d at(int32_t p) const;
  size_t world_of(const SurfacePair& pair) const;
  void check_apart() const;
  void set_reach(int32_t world);
  void set_planes(int32_t p);
  void place_again(std::span<const char> is_new);
  void detect(std::span<const char> is_new);
  Plane plane_between(const SurfacePair& pair) const;
  template <class Body>
  void for_particles(int64_t first_group, int64_t end_group, const Body& body) const;
  void lay_numbers(const Given& given);
  void hold_particle(int32_t p);
  int32_t part_of(int32_t p) const;
  int32_t group_of(int32_t c);
  void make_groups();
  bool join(const SurfacePair& pair);
  void set_shifts();
  bool meets_obstacle(bool searches);
  float edge_factor(const SurfacePair& pair) const;
  SurfaceForce<float> force_of(const Contact& c) const;
  float corners_together(const Contact& c, int32_t p) const;

  const Model& model_;
  const ColorSlots& slots_;
  float radius_ = 0.0f, gap_ = 0.0f;
  std::unique_ptr<SurfacePairs> surface_;
  std::vector<int32_t> world_, color_, vertices_;
  int32_t worlds_ = 1;
  std::vector<Vec4f> rest_, origin_, reference_, wish_, ended_;
  std::vector<float> reach_, safe_;
  std::vector<geometry::Box3> regions_;      // of particles: boxes around origin_ and wish_
  std::vector<char> is_cut_, moves_freely_;  // flag of particles; flag of worlds
  std::vector<int> detections_;              // of worlds: count in this step
  std::vector<double> slack_;                // m, of worlds: least distance to planes
  std::vector<Plane> planes_;                // of pairs
  std::vector<Plane> planes_of_;             // of the items of pairs_of_, with the particle above
  std::vector<float> moved_;                 // of particles: distance from origin_ (m)
  std::vector<int32_t> corners_;             // corners of pairs or contacts
  std::span<const SurfacePair> pairs_;
  std::vector<Contact> contacts_;
  DeviceArray<int32_t> begins_;
  DeviceArray<float> numbers_;
  IndexRows pairs_of_, contacts_of_;  // of particles: 4 times the pair or contact, plus the corner
  // Groups of components that touched (self_contact_balance.cpp). next_: the next component of the
  // group of each component; the last one leads to itself. is_balanced_: whether the momentum of a
  // component is balanced. One more entry is for all particles that are not free. `apart_` and
  // `has_others_` have the values of both at the start of a step.
  std::vector<int32_t> next_, apart_;
  std::vector<char> is_balanced_, has_others_;
  std::vector<Vec3d> shift_;  // m: of components
  std::vector<double> mass_;  // kg: of groups
  std::vector<char> is_far_;  // of worlds: see meets_obstacle
  Rows rows_;
};

// Calls body(particle) for each particle of some groups.
template <class Body>
inline void SelfContact::for_particles(int64_t first_group, int64_t end_group,
                                       const Body& body) const {
  for (auto g = static_cast<size_t>(first_group); g < static_cast<size_t>(end_group); ++g)
    for (int l = 0; l < slots_.filled()[g]; ++l)
      body(slots_.particles()[g * static_cast<size_t>(slots_.lanes()) + static_cast<size_t>(l)]);
}

}  // namespace novaphy::vbd
