#include "coarse.h"

#include <algorithm>
#include <cmath>

#include "novaphy/math/principal_axes.h"
#include "step.h"

namespace novaphy::vbd {
namespace {

using Points = std::vector<Vec3<double>>;

// Calls visit(particle, other) for each slot of a particle and each other corner of the slot.
template <class Visit>
void visit_corners(const ColorSlots& slots, const Visit& visit) {
  const auto lanes = static_cast<size_t>(slots.lanes());
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots.table(role);
    const auto others = static_cast<size_t>(kOthers[role]);
    for (size_t group = 0; group < slots.filled().size(); ++group)
      for (int64_t s = table.begin[group]; s < table.begin[group + 1]; ++s)
        for (size_t lane = 0; lane < lanes; ++lane) {
          const size_t slot = static_cast<size_t>(s);
          if (table.sources[slot * lanes + lane].element < 0) continue;
          for (size_t k = 0; k < others; ++k)
            visit(slots.particles()[group * lanes + lane],
                  table.ints[(slot * others + k) * lanes + lane]);
        }
  }
}

struct Frame {
  Vec3<double> center;
  math::PrincipalAxes axes;
  int rank = 0;  // number of axes along which the points differ: the first axes
};
double along(const math::PrincipalAxes& axes, int axis, const Vec3<double>& d) {
  return axes.axes[0][axis] * d.x + axes.axes[1][axis] * d.y + axes.axes[2][axis] * d.z;
}
// Returns the center and the principal axes of points. The axes have descending second moments.
Frame frame_of(const Points& points, const int32_t* particles, size_t count) {
  Frame f;
  for (size_t k = 0; k < count; ++k)
    f.center = f.center + points[static_cast<size_t>(particles[k])];
  f.center = f.center / static_cast<double>(count);
  Mat33<double> moments;
  for (size_t k = 0; k < count; ++k) {
    const Vec3<double> d = points[static_cast<size_t>(particles[k])] - f.center;
    const double of[3] = {d.x, d.y, d.z};
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) moments.m[r][c] += of[r] * of[c] / static_cast<double>(count);
  }
  const math::PrincipalAxes found = math::principal_axes(moments);
  int order[3] = {0, 1, 2};
  std::stable_sort(order, order + 3,
                   [&](int a, int b) { return found.moments[a] > found.moments[b]; });
  for (int axis = 0; axis < 3; ++axis) {
    f.axes.moments[axis] = found.moments[order[axis]];
    for (int r = 0; r < 3; ++r) f.axes.axes[r][axis] = found.axes[r][order[axis]];
  }
  constexpr double kRounding = 1e-8;  // rounding error of the moments, relative to the largest
  for (int axis = 0; axis < 3; ++axis)
    if (f.axes.moments[axis] > kRounding * f.axes.moments[0]) ++f.rank;
  return f;
}

}  // namespace

CoarseTables::CoarseTables(const Model& model, const ColorSlots& slots) {
  const auto count = static_cast<size_t>(model.particle_count());
  Points points(count);
  for (size_t p = 0; p < count; ++p) {
    const Vec3f& q = model.particle_q.data()[p];
    if (!is_finite(q)) continue;  // then the functions may have any value
    points[p] = {static_cast<double>(q.x), static_cast<double>(q.y), static_cast<double>(q.z)};
  }
  aggregate.assign(count, -1);
  field.resize(count);
  function_begin = member_begin = system_begin = {0};
  const std::vector<int32_t>& component = slots.components();
  IndexRows particles_of;
  particles_of.build(component, slots.component_count());
  for (int32_t c = 0; c < slots.component_count(); ++c) {
    const auto of = particles_of.items(c);
    if (of.size() < 2) continue;
    is_free.push_back(slots.is_free(c) ? 1 : 0);
    std::vector<int32_t> particles(of.begin(), of.end());
    const int rank = frame_of(points, particles.data(), particles.size()).rank;
    const int64_t wanted = (static_cast<int64_t>(particles.size()) + kParticles / 2) / kParticles;
    split(points, particles, 0, particles.size(),
          std::clamp<int64_t>(wanted, 1, kUnknowns / (3 * (rank + 1))));
    system.resize(member_begin.size() - 1, static_cast<int32_t>(system_begin.size()) - 1);
    system_begin.push_back(static_cast<int32_t>(member_begin.size()) - 1);
    const int64_t unknowns = 3 * (function_begin.back() -
                                  function_begin[static_cast<size_t>(*(system_begin.end() - 2))]);
    matrix_begin.push_back(matrix_end);
    matrix_end += unknowns * unknowns;
  }
  find_near(slots);
  add_pairs();
}

// Halves the set of particles along its longest axis, again and again, until each part is an
// aggregate.
void CoarseTables::split(const Points& points, std::vector<int32_t>& particles, size_t begin,
                         size_t end, int64_t parts) {
  const auto first = particles.begin() + static_cast<std::ptrdiff_t>(begin);
  const auto last = particles.begin() + static_cast<std::ptrdiff_t>(end);
  if (parts == 1) return add_aggregate(points, {first, last});
  const Frame frame = frame_of(points, &*first, end - begin);
  const auto place = [&](int32_t p) {
    return along(frame.axes, 0, points[static_cast<size_t>(p)] - frame.center);
  };
  std::sort(first, last,
            [&](int32_t a, int32_t b) { return std::pair(place(a), a) < std::pair(place(b), b); });
  const int64_t left = parts / 2;
  const size_t middle =
      begin + (end - begin) * static_cast<size_t>(left) / static_cast<size_t>(parts);
  split(points, particles, begin, middle, left);
  split(points, particles, middle, end, parts - left);
}

void CoarseTables::add_aggregate(const Points& points, std::vector<int32_t> particles) {
  std::sort(particles.begin(), particles.end());
  const auto number = static_cast<int32_t>(member_begin.size()) - 1;
  const Frame frame = frame_of(points, particles.data(), particles.size());
  for (const int32_t p : particles) {
    aggregate[static_cast<size_t>(p)] = number;
    float of[3] = {};
    for (int axis = 0; axis < frame.rank; ++axis)
      of[axis] = static_cast<float>(
          along(frame.axes, axis, points[static_cast<size_t>(p)] - frame.center) /
          std::sqrt(frame.axes.moments[axis]));
    field[static_cast<size_t>(p)] = Vec3f{of[0], of[1], of[2]};
  }
  members.insert(members.end(), particles.begin(), particles.end());
  member_begin.push_back(static_cast<int32_t>(members.size()));
  function_aggregate.insert(function_aggregate.end(), static_cast<size_t>(frame.rank) + 1, number);
  function_begin.push_back(static_cast<int32_t>(function_aggregate.size()));
}

void CoarseTables::find_near(const ColorSlots& slots) {
  std::vector<std::vector<int32_t>> of_particles(aggregate.size());
  const auto add = [&](int32_t p, int32_t other) {
    std::vector<int32_t>& of = of_particles[static_cast<size_t>(p)];
    const int32_t found = aggregate[static_cast<size_t>(other)];
    if (found >= 0 && std::find(of.begin(), of.end(), found) == of.end()) of.push_back(found);
  };
  for (int32_t p = 0; p < static_cast<int32_t>(aggregate.size()); ++p) add(p, p);
  visit_corners(slots, add);
  near_begin = {0};
  near_row = {0};
  for (std::vector<int32_t>& of : of_particles) {
    std::sort(of.begin(), of.end());
    for (const int32_t a : of) {
      near.push_back(a);
      near_row.push_back(near_row.back() + function_begin[static_cast<size_t>(a) + 1] -
                         function_begin[static_cast<size_t>(a)]);
    }
    near_begin.push_back(static_cast<int32_t>(near.size()));
  }
}

// Adds the pairs of functions whose aggregates are near each other. The larger index comes first.
void CoarseTables::add_pairs() {
  for (size_t a = 0; a + 1 < member_begin.size(); ++a) {
    std::vector<int32_t> others;
    for (int32_t m = member_begin[a]; m < member_begin[a + 1]; ++m) {
      const auto p = static_cast<size_t>(members[static_cast<size_t>(m)]);
      others.insert(others.end(), near.begin() + near_begin[p], near.begin() + near_begin[p + 1]);
    }
    std::sort(others.begin(), others.end());
    others.erase(std::unique(others.begin(), others.end()), others.end());
    for (int32_t g = function_begin[a]; g < function_begin[a + 1]; ++g)
      for (const int32_t b : others)
        for (int32_t h = function_begin[static_cast<size_t>(b)];
             h < std::min(g + 1, function_begin[static_cast<size_t>(b) + 1]); ++h)
          pairs.insert(pairs.end(), {g, h});
  }
}

Coarse::Coarse(const Model& model, const ColorSlots& slots, Device device)
    : Coarse(CoarseTables(model, slots), device) {}

Coarse::Coarse(const CoarseTables& t, Device device)
    : aggregate_(upload<int32_t>(t.aggregate, device)),
      near_begin_(upload<int32_t>(t.near_begin, device)),
      near_(upload<int32_t>(t.near, device)),
      function_begin_(upload<int32_t>(t.function_begin, device)),
      member_begin_(upload<int32_t>(t.member_begin, device)),
      members_(upload<int32_t>(t.members, device)),
      function_aggregate_(upload<int32_t>(t.function_aggregate, device)),
      pairs_(upload<int32_t>(t.pairs, device)),
      system_(upload<int32_t>(t.system, device)),
      system_begin_(upload<int32_t>(t.system_begin, device)),
      is_free_(upload<int32_t>(t.is_free, device)),
      near_row_(upload<uint64_t>(t.near_row, device)),
      matrix_begin_(upload<uint64_t>(t.matrix_begin, device)),
      field_(upload<Vec4f>(t.field, device)),
      force_(t.aggregate.size(), device),
      search_(t.is_free.size(), device),
      shift_(t.is_free.size(), device),
      rows_(9 * static_cast<size_t>(t.near_row.back()), device),
      matrix_(static_cast<size_t>(t.matrix_end), device),
      load_(3 * t.function_aggregate.size(), device),
      step_(3 * t.function_aggregate.size(), device) {}

VbdCoarseArguments Coarse::arguments(const VbdSweepArguments& sweep, int64_t tests) const {
  return {.sweep = sweep,
          .aggregate = aggregate_,
          .field = field_,
          .near_begin = near_begin_,
          .near = near_,
          .near_row = near_row_,
          .function_begin = function_begin_,
          .member_begin = member_begin_,
          .members = members_,
          .function_aggregate = function_aggregate_,
          .pairs = pairs_,
          .system = system_,
          .system_begin = system_begin_,
          .is_free = is_free_,
          .matrix_begin = matrix_begin_,
          .rows = rows_,
          .matrix = matrix_,
          .force = force_,
          .load = load_,
          .step = step_,
          .search = search_,
          .shift = shift_,
          .tests = tests};
}

}  // namespace novaphy::vbd
