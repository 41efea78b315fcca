#include "self_contact.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD: ";
constexpr double kLeastSlack = 1e-6;  // m
constexpr double kTouching = 1e-3;    // part of the slack, below which a distance is 0
constexpr float kParallel = 1e-3f;    // of |e1|^2 |e2|^2, see self_contact_law.h
// Smaller factors and weights are rounding. Their squares leave the range of floats.
constexpr float kLeastFactor = 1e-6f;
constexpr double kLeastWeight = 1e-6;

// Returns the contact radius (m): the option, or twice the common radius of the vertices.
float radius_of(const Model& m, const VbdSelfContact& o, std::span<const int32_t> vertices) {
  if (o.radius) return *o.radius;
  const float* const radius = m.particle_radius.data();
  const auto [least, most] =
      std::minmax_element(vertices.begin(), vertices.end(),
                          [&](int32_t a, int32_t b) { return radius[a] < radius[b]; });
  require(
      radius[*least] == radius[*most], ErrorKind::Value, kName,
      "particle_self_contact_radius: expected a number (m), because particle_radius varies from ",
      radius[*least], " to ", radius[*most], ", got none");
  return 2.0f * radius[*least];
}

// Copies the weights of a pair. The largest weight of a side takes over those that are rounding, so
// that the weights of the side keep their sum.
void set_weights(const SurfacePair& pair, const double (&from)[4], double (&to)[4]) {
  std::copy_n(from, 4, to);
  for (int a = 0; a < 4; ++a) {
    if (!(std::abs(to[a]) < kLeastWeight)) continue;
    int largest = a;
    for (int b = 0; b < 4; ++b)
      if (pair.is_first(a) == pair.is_first(b) && std::abs(to[b]) > std::abs(to[largest]))
        largest = b;
    to[largest] += std::exchange(to[a], 0.0);
  }
}

}  // namespace

SelfContact::SelfContact(const Model& m, const ColorSlots& slots, const VbdSelfContact& o)
    : model_(m), slots_(slots) {
  const auto n = index(m.particle_count());
  const std::span triangles(m.particle_tri_indices.data(), m.particle_tri_indices.rows());
  require(!triangles.empty(), ErrorKind::Value, kName,
          "particle_enable_self_contact: expected a model with triangles, got none");
  const std::span world(m.particle_world.data(), n);
  const std::span rest(m.particle_q.data(), n);
  std::vector<bool> seen(n, false);
  for (const Vec3i& t : triangles)
    for (const int32_t p : {t.x, t.y, t.z}) seen[index(p)] = true;
  for (size_t p = 0; p < n; ++p)
    if (seen[p]) vertices_.push_back(static_cast<int32_t>(p));
  radius_ = radius_of(m, o, vertices_);
  gap_ = o.gap.value_or(radius_ / 3.0f);
  require(std::isfinite(radius_) && radius_ > 0.0f, ErrorKind::Value, kName,
          "particle_self_contact_radius: expected a finite number > 0 (m), got ", radius_);
  require(std::isfinite(gap_) && gap_ > 0.0f, ErrorKind::Value, kName,
          "particle_self_contact_gap: expected a finite number > 0 (m), got ", gap_);
  surface_ = std::make_unique<SurfacePairs>(triangles, world, rest, radius_);
  require(radius_ <= surface_->shortest_edge(), ErrorKind::Value, kName,
          "particle_self_contact_radius: expected at most the length of the shortest edge (",
          surface_->shortest_edge(), " m), got ", radius_);
  for (const Vec3f& v : rest) rest_.push_back({v.x, v.y, v.z, 0.0f});
  origin_ = reference_ = wish_ = rest_;
  reach_.assign(n, 0.0f);
  safe_.assign(n, 0.0f);
  moved_.assign(n, 0.0f);
  regions_.resize(n);
  is_cut_.assign(n, 0);
  begins_ = DeviceArray<int32_t>(n + 1, m.device());
  numbers_ = DeviceArray<float>(kContactFloats, m.device());

  // If a particle belongs to all worlds, all particles count as one world.
  const bool is_apart = std::all_of(vertices_.begin(), vertices_.end(),
                                    [&](int32_t p) { return world[index(p)] >= 0; });
  world_.assign(n, 0);
  worlds_ = is_apart ? std::max(m.world_count(), 1) : 1;
  moves_freely_.assign(index(worlds_), 1);
  for (const int32_t p : vertices_) {
    if (is_apart) world_[index(p)] = world[index(p)];
    if (slots.is_kinematic(p)) moves_freely_[index(world_[index(p)])] = 0;
  }
  make_groups();
  color_.assign(n, -1);
  const std::vector<int64_t>& colors = slots.color_begin();
  for (size_t c = 0; c + 1 < colors.size(); ++c)
    for_particles(colors[c], colors[c + 1],
                  [&](int32_t p) { color_[index(p)] = static_cast<int32_t>(c); });
}

SelfContact::Vec3d SelfContact::at(int32_t p) const { return wide(rows_.x[index(p)]); }

size_t SelfContact::world_of(const SurfacePair& pair) const {
  return index(world_[index(pair.particle[0])]);
}

void SelfContact::begin(const Rows& rows) {
  rows_ = rows;
  if (ended_.empty() || !std::equal(ended_.begin(), ended_.end(), rows.start.begin(),
                                    rows.start.end(), [](const Vec4f& a, const Vec4f& b) {
                                      return a.x == b.x && a.y == b.y && a.z == b.z;
                                    })) {
    const auto crossing = surface_->find_crossing(rows.start);
    if (crossing) {
      const auto& [p, q, a, b, c] = *crossing;
      fail(ErrorKind::Value, "SolverVBD.step: state_in.particle_q: the edge of particles ", p,
           " and ", q, " passes through the triangle of particles ", a, ", ", b, " and ", c,
           "; self-contact needs surfaces that do not cross");
    }
  }
  slack_.assign(index(worlds_), kLeastSlack);
  for (const int32_t p : vertices_) {
    const Vec4f& v = rows.start[index(p)];
    double& slack = slack_[index(world_[index(p)])];
    slack = std::max(slack,
                     4.0 * 0x1p-23 * wide(std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)})));
  }
  next_ = apart_;
  is_balanced_ = has_others_;
  detections_.assign(index(worlds_), 1);
  std::fill(is_cut_.begin(), is_cut_.end(), 0);
  std::copy(rows.x.begin(), rows.x.end(), wish_.begin());
  // In a world without kinematic particles the references move by the mean displacement, because a
  // common displacement of all particles causes no crossing.
  std::vector<Vec3d> shift(index(worlds_));
  std::vector<double> count(index(worlds_));
  for (const int32_t p : vertices_) {
    const size_t w = index(world_[index(p)]);
    shift[w] = shift[w] + (wide(rows.x[index(p)]) - wide(rows.start[index(p)]));
    count[w] += 1.0;
  }
  for (size_t w = 0; w < shift.size(); ++w)
    shift[w] = moves_freely_[w] != 0 && count[w] > 0.0 ? shift[w] * (1.0 / count[w]) : Vec3d{};
  const auto place = [&] {
    for (const int32_t p : vertices_)
      reference_[index(p)] =
          narrow_row(wide(rows.start[index(p)]) + shift[index(world_[index(p)])]);
    origin_ = reference_;
    for (int32_t w = 0; w < worlds_; ++w) set_reach(w);
    detect(std::vector<char>(index(worlds_), 1));
  };
  place();
  // The rounding of a displacement could bring sides together that are this near.
  bool is_near = false;
  for (const SurfacePair& pair : pairs_) {
    if (wide(pair.distance) > slack_[world_of(pair)]) continue;
    shift[world_of(pair)] = Vec3d{};
    is_near = true;
  }
  if (is_near) place();
  check_apart();
  for (const int32_t p : vertices_) hold_particle(p);
}

// ErrorKind::Value: a pair has no direction from one side to the other.
void SelfContact::check_apart() const {
  for (const SurfacePair& pair : pairs_) {
    if (wide(pair.distance) > kTouching * slack_[world_of(pair)]) continue;
    const auto& [p, a, b, c] = pair.particle;
    fail(ErrorKind::Value,
         "SolverVBD.step: state_in.particle_q: expected surfaces that are apart, got 0 m between ",
         pair.has_edges ? "the edge of particles " : "particle ", p,
         pair.has_edges ? " and " : " and the triangle of particles ", a,
         pair.has_edges ? " and that of particles " : ", ", b, " and ", c);
  }
}

void SelfContact::end() {
  for (const int32_t p : slots_.kinematic())
    require(is_cut_[index(p)] == 0, ErrorKind::Runtime, "SolverVBD.step: targets: particle ", p,
            " would cross a surface on its way; state_out was not written");
  ended_.assign(rows_.x.begin(), rows_.x.end());
}

float SelfContact::edge_factor(const SurfacePair& pair) const {
  if (!pair.has_edges) return 1.0f;
  const auto rest = [&](size_t k) {
    const Vec3d e = wide(rest_[index(pair.particle[k + 1])]) - wide(rest_[index(pair.particle[k])]);
    return math::dot(e, e);
  };
  const Vec3d n = math::cross(at(pair.particle[1]) - at(pair.particle[0]),
                              at(pair.particle[3]) - at(pair.particle[2]));
  const double s = math::dot(n, n) / (wide(kParallel) * rest(0) * rest(2));
  return s < 1.0 ? narrow((2.0 - s) * s) : 1.0f;
}

void SelfContact::find_contacts(const Given& given) {
  contacts_.clear();
  corners_.clear();
  for (const int32_t p : vertices_)
    moved_[index(p)] = narrow(length_of(at(p) - wide(origin_[index(p)]))) * 1.0001f;
  for (size_t k = 0; k < pairs_.size(); ++k) {
    const SurfacePair& pair = pairs_[k];
    const auto most = [&](size_t a, size_t b) {
      return std::max(moved_[index(pair.particle[a])], moved_[index(pair.particle[b])]);
    };
    const float moved =
        pair.has_edges ? most(0, 1) + most(2, 3) : most(0, 0) + std::max(most(1, 2), most(3, 3));
    if (pair.distance * 0.9999f - moved >= pair.radius) continue;
    Vec3d x[4];
    for (size_t c = 0; c < 4; ++c) x[c] = at(pair.particle[c]);
    const auto nearest =
        pair.has_edges ? geometry::nearest_of_edges(x) : geometry::nearest_to_triangle(x);
    if (!(nearest.distance < wide(pair.radius))) continue;
    Contact c = {.pair = k,
                 .normal = nearest.distance > 1e-9 ? nearest.apart * (1.0 / nearest.distance)
                                                   : planes_[k].normal,
                 .weight = {},
                 .gap = nearest.distance,
                 .factor = edge_factor(pair),
                 .load = 0.0f};
    if (c.factor < kLeastFactor) continue;
    c.load = -c.factor * gap_derivatives(narrow(c.gap), pair.radius, model_.soft_contact_ke).first;
    set_weights(pair, nearest.weight, c.weight);
    for (size_t a = 0; a < 4; ++a) corners_.push_back(c.weight[a] != 0.0 ? pair.particle[a] : -1);
    contacts_.push_back(c);
    join(pair);
  }
  contacts_of_.build(corners_, model_.particle_count());
  lay_numbers(given);
}

// Assigns memory to the contacts of each particle: first contacts with shapes, then with surfaces.
void SelfContact::lay_numbers(const Given& given) {
  const auto shapes_of = [&](int32_t p) {
    return given.begin != nullptr ? given.begin[p + 1] - given.begin[p] : 0;
  };
  int32_t* const begin = begins_.mutable_data();
  for (int32_t p = 0; p < model_.particle_count(); ++p)
    begin[p + 1] = begin[p] + shapes_of(p) + static_cast<int32_t>(contacts_of_.items(p).size());
  const auto floats = index(begin[model_.particle_count()]) * kContactFloats;
  if (numbers_.rows() < floats) numbers_ = DeviceArray<float>(floats + floats / 2, model_.device());
  for (int32_t p = 0; p < model_.particle_count(); ++p)
    if (shapes_of(p) != 0)
      std::copy_n(given.numbers + index(given.begin[p]) * kContactFloats,
                  index(shapes_of(p)) * kContactFloats,
                  numbers_.mutable_data() + index(begin[p]) * kContactFloats);
}

// Returns the force of a contact at the current positions.
SurfaceForce<float> SelfContact::force_of(const Contact& c) const {
  const SurfacePair& pair = pairs_[c.pair];
  Vec3d apart{}, moved{};
  for (size_t k = 0; k < 4; ++k) {
    const size_t p = index(pair.particle[k]);
    const Vec3d x = wide(rows_.x[p]);
    apart = apart + x * c.weight[k];
    moved = moved + (x - wide(rows_.start[p])) * c.weight[k];
  }
  SurfaceForce<float> s;
  const auto gap = narrow(math::dot(c.normal, apart));
  if (!(gap < pair.radius)) return s;
  const GapDerivatives<float> derivatives =
      gap_derivatives(gap, pair.radius, model_.soft_contact_ke);
  const double un = math::dot(c.normal, moved);
  const float damping = un < 0.0 ? c.factor * model_.soft_contact_kd / rows_.h : 0.0f;
  s.normal = narrow(c.normal);
  s.slip = narrow(moved - c.normal * un);
  s.along = -c.factor * derivatives.first - damping * narrow(un);
  s.stiffness = c.factor * derivatives.second + damping;
  const float slip = math::length(s.slip), eps = rows_.slip;
  const float shape = slip > eps ? 1.0f / slip : (2.0f - slip / eps) / eps;
  s.friction = model_.soft_contact_mu * c.load * shape;
  return s;
}

// Returns how many corners of a contact have the color of the corner p. The count includes p.
float SelfContact::corners_together(const Contact& c, int32_t p) const {
  float count = 0.0f;
  for (size_t k = 0; k < 4; ++k)
    if (c.weight[k] != 0.0 && color_[index(pairs_[c.pair].particle[k])] == color_[index(p)])
      count += 1.0f;
  return count;
}

void SelfContact::put_numbers(int64_t first_group, int64_t end_group) {
  float* const all = numbers_.mutable_data();
  for_particles(first_group, end_group, [&](int32_t p) {
    const std::span<const int32_t> items = contacts_of_.items(p);
    float* to = all + (index(begins_.data()[p + 1]) - items.size()) * kContactFloats;
    for (const int32_t item : items) {
      const Contact& c = contacts_[index(item / 4)];
      const Vec4f &x = rows_.x[index(p)], &start = rows_.start[index(p)];
      const ParticleContact<float> of =
          corner_contact(force_of(c), narrow(c.weight[index(item % 4)]), corners_together(c, p),
                         Vec3f{x.x, x.y, x.z}, Vec3f{start.x, start.y, start.z}, rows_.slip);
      for (const float number :
           {of.point.x, of.point.y, of.point.z, of.normal.x, of.normal.y, of.normal.z, of.travel.x,
            of.travel.y, of.travel.z, of.radius, of.ke, of.kd_by_h, of.mu})
        *to++ = number;
    }
  });
}

VbdSelfContacts SelfContact::contacts() const {
  VbdSelfContacts all;
  for (const Contact& c : contacts_) {
    all.particles.push_back(pairs_[c.pair].particle);
    all.gaps.push_back(narrow(c.gap));
    all.forces.push_back(c.load);
    all.has_edges.push_back(pairs_[c.pair].has_edges);
  }
  return all;
}

}  // namespace novaphy::vbd
