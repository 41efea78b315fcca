// ModelBuilder: collects particles and shapes, checks them, and makes Models.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "novaphy/core/device.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/shape_config.h"

namespace novaphy {

// Gravity of a builder, m/s^2: a number along the up axis (so usually negative), or a vector.
struct GravitySpec {
  std::optional<float> along_up = -9.81f;
  Vec3f vector{};
  GravitySpec() = default;
  GravitySpec(float value) : along_up(value) {}
  GravitySpec(const Vec3f& value) : along_up(), vector(value) {}
};

// The options of the add_shape_* functions. An empty `cfg` means ModelBuilder::default_shape_cfg;
// an empty `label` means "shape_<index>". `xform` is the pose of the shape in its body, in the
// world for body -1.
struct ShapeArgs {
  int32_t body = -1;
  GeoType type = GeoType::NONE;
  Transformf xform = Transformf::identity();
  Vec3f scale{};  // see GeoType
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapePlaneArgs {
  Vec4f plane{0.0f, 0.0f, 1.0f,
              0.0f};  // a*x + b*y + c*z + d = 0, normal (a, b, c): (0, 0, 1, -h) is z = h
  std::optional<Transformf> xform = {};  // wins over `plane`; local +z is the normal
  float width = 10.0f, length = 10.0f;   // m, along local x and y; infinite unless both are > 0
  int32_t body = -1;
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct GroundArgs {
  float height = 0.0f;  // m along the up axis
  std::optional<ShapeConfig> cfg = {};
  std::string label = "ground_plane";
};
struct ShapeSphereArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f;  // m
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeBoxArgs {
  Transformf xform = Transformf::identity();
  float hx = 0.5f, hy = 0.5f, hz = 0.5f;  // m, half extents
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeCapsuleArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f, half_height = 0.5f;  // m; along local z, half_height excludes the caps
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};

struct FinalizeOptions {
  bool requires_grad = false;
  bool skip_validation = false;  // no second check of values; the lists' sizes are checked
};

// Every add_* function checks its arguments and leaves the builder as it was when one is bad:
//   ErrorKind::Value           not finite, negative, non-positive extent, quaternion not of unit
//   length, ... ErrorKind::Index           a body or shape that is not there
//   ErrorKind::NotImplemented  a shape type that is not there yet
// Quaternions may miss unit length by 1e-3 and are then normalised; one that is already of unit
// length to float rounding keeps its bits.
class NOVAPHY_CORE_API ModelBuilder {
 public:
  explicit ModelBuilder(Axis up_axis = Axis::Z, const GravitySpec& gravity = {});

  Axis up_axis() const { return up_axis_; }
  Vec3f up_vector() const { return axis_vector(up_axis_); }

  // Settings; they act on what is added after they were changed.
  Vec3f gravity;                         // m/s^2, world; read by finalize
  float default_particle_radius = 0.1f;  // m
  ShapeConfig default_shape_cfg;
  float rigid_gap = 0.1f;  // m: the gap of shapes whose ShapeConfig has none

  // The particles so far. Values may be edited before finalize, which checks them again.
  std::vector<Vec3f> particle_q, particle_qd;  // m, m/s, world
  std::vector<float> particle_mass;            // kg
  std::vector<float> particle_radius;          // m
  std::vector<int32_t> particle_flags;         // ParticleFlags
  std::vector<int32_t> particle_world;         // -1: all worlds

  int32_t particle_count() const { return static_cast<int32_t>(particle_q.size()); }
  int32_t body_count() const { return 0; }
  int32_t shape_count() const { return static_cast<int32_t>(shapes_.size()); }

  // Returns the index. `mass` 0 makes the particle kinematic: it keeps its velocity.
  int32_t add_particle(const Vec3f& pos, const Vec3f& vel, float mass,
                       std::optional<float> radius = {},
                       int32_t flags = static_cast<int32_t>(ParticleFlags::ACTIVE));
  // The lists have one length (ErrorKind::Value); empty `radius` and `flags` mean the defaults.
  void add_particles(std::span<const Vec3f> pos, std::span<const Vec3f> vel,
                     std::span<const float> mass, std::span<const float> radius = {},
                     std::span<const int32_t> flags = {});

  // All return the index of the shape. `body` -1 is the world; there are no rigid bodies yet.
  int32_t add_shape(const ShapeArgs& args);
  int32_t add_shape_plane(const ShapePlaneArgs& args = {});
  int32_t add_ground_plane(const GroundArgs& args = {});  // infinite, its normal is the up axis
  int32_t add_shape_sphere(int32_t body, const ShapeSphereArgs& args = {});
  int32_t add_shape_box(int32_t body, const ShapeBoxArgs& args = {});
  int32_t add_shape_capsule(int32_t body, const ShapeCapsuleArgs& args = {});

  // The two shapes never meet. ErrorKind::Index: no such shape; ErrorKind::Value: a == b.
  void add_shape_collision_filter_pair(int32_t a, int32_t b);

  // Checks everything and makes a model; the builder stays as it is and may be used again. `device`
  // must be there (ErrorKind::Runtime).
  std::shared_ptr<Model> finalize(Device device = default_device(),
                                  const FinalizeOptions& options = {}) const;

 private:
  struct Shape {
    int32_t body;
    GeoType type;
    Transformf xform;
    Vec3f scale;
    ShapeConfig cfg;
    float gap;
    std::string label = {};
  };

  int32_t append_shape(std::string_view function, const ShapeArgs& args);
  void check_sizes() const;
  void check_values() const;

  Axis up_axis_;
  std::vector<Shape> shapes_;
  std::set<std::pair<int32_t, int32_t>> filter_pairs_;
};

// The shape pairs (i < j, lexicographic) that may touch: both collide with shapes, worlds and
// groups meet, not on one body, not both world-owned, not filtered. `body` -1 is the world. All
// spans have one row per shape.
NOVAPHY_CORE_API std::vector<Vec2i> make_shape_contact_pairs(
    std::span<const int32_t> body, std::span<const int32_t> flags,
    std::span<const int32_t> collision_group, std::span<const int32_t> world,
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs);

}  // namespace novaphy
