// Regular grids: particles, cloth, soft bodies.
#include <cmath>

#include "builder_checks.h"
#include "builder_transaction.h"
#include "novaphy/core/error.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

void check_dimension(std::string_view function, const char* name, int32_t value, int32_t least) {
  constexpr int32_t kMost = 1 << 20;
  require(value >= least && value <= kMost, ErrorKind::Value, function, ": ", name, ": expected ",
          least, " to ", kMost, ", got ", value);
}
void check_cell(std::string_view function, const char* name, double value) {
  require(std::isfinite(value) && value > 0.0, ErrorKind::Value, function, ": ", name,
          ": expected a finite number > 0, got ", value);
}
void check_particles(std::string_view function, int64_t count) {
  require(count <= INT32_MAX, ErrorKind::Value, function,
          ": expected a grid of at most 2147483647 particles, got ", count);
}
Vec3f rounded(double x, double y, double z) {
  return {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)};
}

// A random number generator with the same results on every platform (splitmix64).
class Random {
 public:
  explicit Random(uint64_t seed) : state_(seed) {}
  double uniform() {  // [0, 1)
    state_ += 0x9E3779B97F4A7C15u;
    uint64_t x = state_;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return static_cast<double>((x ^ (x >> 31)) >> 11) * 0x1p-53;
  }
  double normal() {  // Box and Muller
    const auto u = static_cast<float>(1.0 - uniform()), v = static_cast<float>(uniform());
    return static_cast<double>(math::sqrt(-2.0f * math::log(u)) * math::cos(6.2831853f * v));
  }

 private:
  uint64_t state_;
};

}  // namespace

void ModelBuilder::add_particle_grid(const ParticleGridArgs& args) {
  constexpr std::string_view name = "add_particle_grid";
  check_dimension(name, "dim_x", args.dim_x, 0);
  check_dimension(name, "dim_y", args.dim_y, 0);
  check_dimension(name, "dim_z", args.dim_z, 0);
  check_cell(name, "cell_x", args.cell_x);
  check_cell(name, "cell_y", args.cell_y);
  check_cell(name, "cell_z", args.cell_z);
  const auto check_spread = [&](const char* argument, double value) {
    require(std::isfinite(value) && value >= 0.0, ErrorKind::Value, name, ": ", argument,
            ": expected a finite number >= 0, got ", value);
  };
  check_spread("jitter", args.jitter);
  check_spread("radius_std", args.radius_std);
  check_particles(name, int64_t{args.dim_x} * args.dim_y * args.dim_z);
  const Quatf rot = detail::checked_pose(name, {args.placement.pos, args.placement.rot}).q;
  const float mean = args.radius_mean.value_or(default_particle_radius);
  Random random(args.seed);
  Transaction transaction(*this);
  for (int32_t y = 0; y < args.dim_y; ++y)
    for (int32_t x = 0; x < args.dim_x; ++x)
      for (int32_t z = 0; z < args.dim_z; ++z) {
        const Vec3f local = rounded(x * args.cell_x, y * args.cell_y, z * args.cell_z);
        const auto offset = [&] { return (random.uniform() - 0.5) * args.jitter; };
        const double dx = offset(), dy = offset(), dz = offset();
        const double spread = args.radius_std > 0.0 ? random.normal() * args.radius_std : 0.0;
        const auto radius = static_cast<float>(static_cast<double>(mean) + spread);
        add_particle(math::rotate(rot, local) + args.placement.pos + rounded(dx, dy, dz),
                     args.placement.vel, args.mass,
                     args.radius_std > 0.0 ? math::max(radius, 0.0f) : radius);
      }
  transaction.keep();
}

void ModelBuilder::add_cloth_grid(const ClothGridArgs& args) {
  constexpr std::string_view name = "add_cloth_grid";
  check_dimension(name, "dim_x", args.dim_x, 1);
  check_dimension(name, "dim_y", args.dim_y, 1);
  check_cell(name, "cell_x", args.cell_x);
  check_cell(name, "cell_y", args.cell_y);
  detail::check_mass({name, "mass"}, args.mass);
  const int32_t stride = args.dim_x + 1;
  check_particles(name, int64_t{stride} * (args.dim_y + 1));
  std::vector<Vec3f> vertices;
  std::vector<int32_t> indices;
  for (int32_t y = 0; y <= args.dim_y; ++y)
    for (int32_t x = 0; x <= args.dim_x; ++x) {
      vertices.push_back(rounded(x * args.cell_x, y * args.cell_y, 0.0));
      if (x == 0 || y == 0) continue;
      const int32_t v2 = y * stride + x, v3 = v2 - 1, v1 = v2 - stride, v0 = v1 - 1;
      if (args.reverse_winding) {
        indices.insert(indices.end(), {v0, v1, v2, v0, v2, v3});
      } else {
        indices.insert(indices.end(), {v0, v1, v3, v1, v2, v3});
      }
    }
  Transaction transaction(*this);
  auto particle = static_cast<size_t>(particle_count());
  append_cloth(name, {.placement = args.placement,
                      .vertices = vertices,
                      .indices = indices,
                      .density = 0.0,
                      .tri = args.tri,
                      .edge = args.edge,
                      .add_springs = args.add_springs,
                      .spring_ke = args.spring_ke,
                      .spring_kd = args.spring_kd,
                      .particle_radius = args.particle_radius});
  for (int32_t y = 0; y <= args.dim_y; ++y)
    for (int32_t x = 0; x <= args.dim_x; ++x, ++particle) {
      const bool fixed = (x == 0 && args.fix_left) || (x == args.dim_x && args.fix_right) ||
                         (y == 0 && args.fix_bottom) || (y == args.dim_y && args.fix_top);
      particle_mass[particle] = fixed ? 0.0f : args.mass;
      if (fixed) particle_flags[particle] &= ~static_cast<int32_t>(ParticleFlags::ACTIVE);
    }
  transaction.keep();
}

namespace {
// Returns the mass of each particle of a grid. Particles of a fixed side have none.
std::vector<float> masses_of(std::string_view name, const SoftGridArgs& args) {
  const double cell = args.cell_x * args.cell_y * args.cell_z * args.density;
  const auto part = [](int32_t at, int32_t cells) { return at == 0 || at == cells ? 0.5 : 1.0; };
  std::vector<float> masses;
  for (int32_t z = 0; z <= args.dim_z; ++z)
    for (int32_t y = 0; y <= args.dim_y; ++y)
      for (int32_t x = 0; x <= args.dim_x; ++x) {
        const double cells = part(x, args.dim_x) * part(y, args.dim_y) * part(z, args.dim_z);
        const bool fixed = (x == 0 && args.fix_left) || (x == args.dim_x && args.fix_right) ||
                           (y == 0 && args.fix_bottom) || (y == args.dim_y && args.fix_top);
        masses.push_back(fixed ? 0.0f : static_cast<float>(cells * cell));
        detail::check_mass({name, "density"}, masses.back());
      }
  return masses;
}
}  // namespace

void ModelBuilder::add_soft_grid(const SoftGridArgs& args) {
  constexpr std::string_view name = "add_soft_grid";
  check_dimension(name, "dim_x", args.dim_x, 1);
  check_dimension(name, "dim_y", args.dim_y, 1);
  check_dimension(name, "dim_z", args.dim_z, 1);
  check_cell(name, "cell_x", args.cell_x);
  check_cell(name, "cell_y", args.cell_y);
  check_cell(name, "cell_z", args.cell_z);
  require(std::isfinite(args.density) && args.density >= 0.0, ErrorKind::Value, name,
          ": density: expected a finite number >= 0, got ", args.density);
  const TetMaterials material = {one_of(args.k_mu), one_of(args.k_lambda), one_of(args.k_damp),
                                 one_of(args.youngs_modulus), one_of(args.poisson_ratio)};
  detail::check_tet_materials(name, material, 1);
  const int32_t nx = args.dim_x + 1, ny = args.dim_y + 1, nz = args.dim_z + 1;
  check_particles(name, int64_t{nx} * ny * nz);

  std::vector<Vec3f> vertices;
  for (int32_t z = 0; z < nz; ++z)
    for (int32_t y = 0; y < ny; ++y)
      for (int32_t x = 0; x < nx; ++x)
        vertices.push_back(rounded(x * args.cell_x, y * args.cell_y, z * args.cell_z));
  const std::vector<float> masses = masses_of(name, args);
  Transaction transaction(*this);
  const int32_t first = append_vertices(name, args.placement, 1.0, vertices, args.particle_radius);
  for (size_t n = 0; n < masses.size(); ++n)
    particle_mass[static_cast<size_t>(first) + n] = masses[n];

  std::vector<Vec4i> tetrahedra;
  const auto add = [&](int32_t i, int32_t j, int32_t k, int32_t l) {
    tetrahedra.push_back({i, j, k, l});
    append_tetrahedron(name, tetrahedra.back(), material, 0);
  };
  for (int32_t z = 0; z < args.dim_z; ++z)
    for (int32_t y = 0; y < args.dim_y; ++y)
      for (int32_t x = 0; x < args.dim_x; ++x) {
        // Corners of the cell: v0 to v3 around the lower y face, v4 to v7 above them.
        const auto at = [&](int32_t dx, int32_t dy, int32_t dz) {
          return first + nx * ny * (z + dz) + nx * (y + dy) + (x + dx);
        };
        const int32_t v0 = at(0, 0, 0), v1 = at(1, 0, 0), v2 = at(1, 0, 1), v3 = at(0, 0, 1);
        const int32_t v4 = at(0, 1, 0), v5 = at(1, 1, 0), v6 = at(1, 1, 1), v7 = at(0, 1, 1);
        // Cells alternate between two mirrored patterns, so that diagonals of neighbors coincide.
        if ((x ^ y ^ z) & 1) {
          add(v0, v1, v4, v3);
          add(v2, v3, v6, v1);
          add(v5, v4, v1, v6);
          add(v7, v6, v3, v4);
          add(v4, v1, v6, v3);
        } else {
          add(v1, v2, v5, v0);
          add(v3, v0, v7, v2);
          add(v4, v7, v0, v5);
          add(v6, v5, v2, v7);
          add(v5, v2, v7, v0);
        }
      }
  append_surface(name, tetrahedra, args.tri, args.add_surface_mesh_edges, args.edge);
  transaction.keep();
}

}  // namespace novaphy
