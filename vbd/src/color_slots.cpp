#include "color_slots.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "parameter_arrays.h"

namespace novaphy::vbd {
namespace {

// Rows of `width` indices or coefficients of the elements of one kind.
struct Kind {
  const char* indices_name;
  const Array& indices;
  const Array& material;
  int corners;
  bool may_be_absent = false;

  int32_t count() const { return static_cast<int32_t>(indices.rows()); }
  const int32_t* corner(int32_t e) const {
    return static_cast<const int32_t*>(indices.raw()) + static_cast<int64_t>(e) * corners;
  }
  size_t width() const { return material.width(); }
  const float* coefficients(int32_t e) const {
    return static_cast<const float*>(material.raw()) + static_cast<size_t>(e) * width();
  }
};

void check_elements(const Kind& kind, int32_t particles) {
  for (int32_t e = 0; e < kind.count(); ++e) {
    for (int c = 0; c < kind.corners; ++c) {
      const int32_t p = kind.corner(e)[c];
      require((p >= 0 && p < particles) || (kind.may_be_absent && p == -1), ErrorKind::Index,
              "SolverVBD: model.", kind.indices_name, "[", e, "]: expected particles from 0 to ",
              particles - 1, kind.may_be_absent ? ", or -1" : "", ", got ", p);
    }
  }
}

// Whether one of the first coefficients of an element is not 0.
bool acts(const Kind& kind, int32_t e, size_t columns) {
  return std::any_of(kind.coefficients(e), kind.coefficients(e) + columns,
                     [](float value) { return value != 0.0f; });
}

struct Kinds {
  Kind spring_ke, spring_kd, triangle, edge, tetrahedron;
  explicit Kinds(const Model& m)
      : spring_ke{"particle_spring_indices", m.particle_spring_indices, m.particle_spring_stiffness,
                  2},
        spring_kd{"particle_spring_indices", m.particle_spring_indices, m.particle_spring_damping,
                  2},
        triangle{"particle_tri_indices", m.particle_tri_indices, m.particle_tri_material, 3},
        edge{"particle_edge_indices", m.particle_edge_indices, m.particle_edge_material, 4, true},
        tetrahedron{"particle_tet_indices", m.particle_tet_indices, m.particle_tet_material, 4} {}

  // Calls visit(role of corner c, element, corners, number of them) for the elements that act.
  template <class Visit>
  void visit(Visit&& visit) const {
    static constexpr Role kSpringRoles[] = {kSpring, kSpring};
    static constexpr Role kTriangleRoles[] = {kTriangle, kTriangle, kTriangle};
    static constexpr Role kHingeRoles[] = {kHingeOpposite, kHingeOpposite, kHingeEnd, kHingeEnd};
    static constexpr Role kTetrahedronRoles[] = {kTetrahedron, kTetrahedron, kTetrahedron,
                                                 kTetrahedron};
    for (int32_t e = 0; e < spring_ke.count(); ++e)
      if (acts(spring_ke, e, 1) || acts(spring_kd, e, 1))
        visit(kSpringRoles, e, spring_ke.corner(e), 2);
    for (int32_t e = 0; e < triangle.count(); ++e)
      if (acts(triangle, e, 3)) visit(kTriangleRoles, e, triangle.corner(e), 3);
    for (int32_t e = 0; e < edge.count(); ++e) {
      const int32_t* const p = edge.corner(e);
      if (acts(edge, e, 2) && std::none_of(p, p + 4, [](int32_t corner) { return corner < 0; }))
        visit(kHingeRoles, e, p, 4);
    }
    for (int32_t e = 0; e < tetrahedron.count(); ++e)
      if (acts(tetrahedron, e, 3)) visit(kTetrahedronRoles, e, tetrahedron.corner(e), 4);
  }
};

void check_drag(const Kind& triangle) {
  for (int32_t e = 0; e < triangle.count(); ++e) {
    const float* const c = triangle.coefficients(e);
    require(c[3] == 0.0f && c[4] == 0.0f, ErrorKind::NotImplemented,
            "SolverVBD: model.particle_tri_material[", e,
            "]: drag and lift are not there yet, expected 0, got ", c[3], " and ", c[4]);
  }
}

void check_control(const Model& model) {
  const std::vector<float> control = model.particle_spring_control.to_host();
  for (size_t e = 0; e < control.size(); ++e)
    require(control[e] == 0.0f, ErrorKind::NotImplemented,
            "SolverVBD: model.particle_spring_control[", e,
            "]: expected 0, because no force of VBD uses it, got ", control[e]);
}

}  // namespace

void ColorSlots::find_held(const Model& model) {
  const int32_t* flags = model.particle_flags.data();
  const float* inv_mass = model.particle_inv_mass.data();
  is_held_.assign(static_cast<size_t>(model.particle_count()), 0);
  held_.clear();
  for (int32_t p = 0; p < model.particle_count(); ++p) {
    if (has_flag(flags[p], ParticleFlags::ACTIVE) && inv_mass[p] > 0.0f) continue;
    is_held_[static_cast<size_t>(p)] = 1;
    held_.push_back(p);
  }
}

// The slots of every particle, by role, in the order of the elements.
void ColorSlots::collect(const Model& model) {
  const Kinds kinds(model);
  const auto count = static_cast<size_t>(model.particle_count());
  for (Table& table : tables_) table.particle_begin.assign(count + 1, 0);
  kinds.visit([&](const Role* roles, int32_t, const int32_t* corners, int n) {
    for (int c = 0; c < n; ++c)
      if (!is_held(corners[c]))
        ++tables_[roles[c]].particle_begin[static_cast<size_t>(corners[c]) + 1];
  });
  std::vector<int64_t> next[kRoles];
  for (int role = 0; role < kRoles; ++role) {
    Table& table = tables_[role];
    std::partial_sum(table.particle_begin.begin(), table.particle_begin.end(),
                     table.particle_begin.begin());
    table.of_particles.resize(static_cast<size_t>(table.particle_begin.back()));
    next[role] = table.particle_begin;
  }
  kinds.visit([&](const Role* roles, int32_t e, const int32_t* corners, int n) {
    for (int c = 0; c < n; ++c) {
      if (is_held(corners[c])) continue;
      int64_t& place = next[roles[c]][static_cast<size_t>(corners[c])];
      tables_[roles[c]].of_particles[static_cast<size_t>(place++)] = {e, c};
    }
  });
  for (int role = 0; role < kRoles; ++role)  // the slots of a particle end where the next begin
    NOVAPHY_ASSERT(std::equal(next[role].begin(), next[role].end() - 1,
                              tables_[role].particle_begin.begin() + 1));
}

void ColorSlots::find_conflicts(const std::vector<int32_t>& colors, const Model& model) {
  has_conflicts_ = false;
  Kinds(model).visit([&](const Role*, int32_t, const int32_t* corners, int n) {
    for (int c = 0; c < n; ++c)
      for (int d = 0; d < c; ++d)
        has_conflicts_ |=
            corners[c] != corners[d] && !is_held(corners[c]) && !is_held(corners[d]) &&
            colors[static_cast<size_t>(corners[c])] == colors[static_cast<size_t>(corners[d])];
  });
}

// Within a colour the particles with the most slots come first, so that the lanes of a group have
// about equally many.
void ColorSlots::make_groups(const std::vector<int32_t>& colors) {
  std::vector<std::vector<int32_t>> of_color;
  for (size_t p = 0; p < colors.size(); ++p) {
    if (is_held_[p] != 0) continue;
    const auto color = static_cast<size_t>(colors[p]);
    if (color >= of_color.size()) of_color.resize(color + 1);
    of_color[color].push_back(static_cast<int32_t>(p));
  }
  const auto slots = [this](int role, int32_t p) {
    const std::vector<int64_t>& begin = tables_[role].particle_begin;
    return begin[static_cast<size_t>(p) + 1] - begin[static_cast<size_t>(p)];
  };
  particle_.clear();
  filled_.clear();
  color_begin_.assign(1, 0);
  for (std::vector<int32_t>& particles : of_color) {
    std::stable_sort(particles.begin(), particles.end(), [&](int32_t a, int32_t b) {
      for (int role = 0; role < kRoles; ++role)
        if (slots(role, a) != slots(role, b)) return slots(role, a) > slots(role, b);
      return false;
    });
    for (size_t first = 0; first < particles.size(); first += static_cast<size_t>(lanes_)) {
      const size_t filled = std::min(particles.size() - first, static_cast<size_t>(lanes_));
      for (size_t lane = 0; lane < static_cast<size_t>(lanes_); ++lane)
        particle_.push_back(particles[first + (lane < filled ? lane : 0)]);
      filled_.push_back(static_cast<int32_t>(filled));
    }
    color_begin_.push_back(static_cast<int64_t>(filled_.size()));
  }
  NOVAPHY_ASSERT(particle_.size() == filled_.size() * static_cast<size_t>(lanes_));
}

void ColorSlots::lay_slots(const Model& model) {
  const Kinds kinds(model);
  const Kind* const kind_of[kRoles] = {&kinds.spring_ke, &kinds.triangle, &kinds.edge, &kinds.edge,
                                       &kinds.tetrahedron};
  const auto lanes = static_cast<size_t>(lanes_);
  for (int role = 0; role < kRoles; ++role) {
    Table& table = tables_[role];
    const Kind& kind = *kind_of[role];
    const auto ints = static_cast<size_t>(kInts[role]);
    table.begin.assign(1, 0);
    table.sources.clear();
    table.ints.clear();
    for (size_t group = 0; group < filled_.size(); ++group) {
      const int32_t* const particle = particle_.data() + group * lanes;
      int64_t most = 0;
      const auto first = [&](size_t lane) {
        return table.particle_begin[static_cast<size_t>(particle[lane])];
      };
      const auto count = [&](size_t lane) {
        if (lane >= static_cast<size_t>(filled_[group])) return int64_t{0};
        return table.particle_begin[static_cast<size_t>(particle[lane]) + 1] - first(lane);
      };
      for (size_t lane = 0; lane < lanes; ++lane) most = std::max(most, count(lane));
      for (int64_t s = 0; s < most; ++s) {
        const size_t base = table.ints.size();
        table.ints.resize(base + ints * lanes);
        for (size_t lane = 0; lane < lanes; ++lane) {
          const Source source =
              s < count(lane) ? table.of_particles[static_cast<size_t>(first(lane) + s)] : Source{};
          table.sources.push_back(source);
          for (size_t k = 0; k < ints; ++k) {
            int32_t& index = table.ints[base + k * lanes + lane];
            index = particle[lane];
            if (source.element < 0) continue;
            const int32_t* const corner = kind.corner(source.element);
            const auto c = static_cast<size_t>(source.corner);
            // A hinge keeps its four places; odd corners read it from its other side. The others
            // list the corners that follow their own.
            index = kind.corners == 4 && ints == 4
                        ? corner[c % 2 == 0 ? k : k ^ 1u]
                        : corner[(c + 1 + k) % static_cast<size_t>(kind.corners)];
          }
        }
      }
      table.begin.push_back(table.begin.back() + most);
    }
    NOVAPHY_ASSERT(table.begin.size() == filled_.size() + 1);
    NOVAPHY_ASSERT(table.sources.size() == static_cast<size_t>(table.begin.back()) * lanes);
    NOVAPHY_ASSERT(table.ints.size() == table.sources.size() * ints);
    table.corners = static_cast<size_t>(kind.corners);
    table.places.assign(kind.indices.rows() * table.corners, -1);
    for (size_t k = 0; k < table.sources.size(); ++k)
      if (table.sources[k].element >= 0)
        table.places[static_cast<size_t>(table.sources[k].element) * table.corners +
                     static_cast<size_t>(table.sources[k].corner)] = static_cast<int64_t>(k);
    table.floats.assign(table.sources.size() * static_cast<size_t>(kFloats[role]), 0.0f);
  }
}

void ColorSlots::build(const Model& model, int lanes) {
  lanes_ = lanes;
  const Kinds kinds(model);
  for (const Kind* kind : {&kinds.spring_ke, &kinds.triangle, &kinds.edge, &kinds.tetrahedron})
    check_elements(*kind, model.particle_count());
  check_drag(kinds.triangle);
  check_control(model);
  const std::vector<int32_t> colors = model.particle_colors.to_host();
  for (size_t p = 0; p < colors.size(); ++p)
    require(colors[p] >= 0, ErrorKind::Value, "SolverVBD: model: particle ", p,
            " has no colour; call ModelBuilder.color() (or set_coloring) before finalize");
  find_held(model);
  find_conflicts(colors, model);
  collect(model);
  make_groups(colors);
  lay_slots(model);
}

void ColorSlots::set_constants(const Model& model, float dt) {
  const auto lanes = static_cast<size_t>(lanes_);
  const float inverse_h2 = 1.0f / (dt * dt);
  const float* mass = model.particle_mass.data();
  mass_by_h2_.resize(particle_.size());
  for (size_t k = 0; k < particle_.size(); ++k) {
    const bool filled = k % lanes < static_cast<size_t>(filled_[k / lanes]);
    mass_by_h2_[k] = filled ? mass[particle_[k]] * inverse_h2 : 1.0f;
  }
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    Table& table = tables_[role];
    const auto arrays = parameters_on_host(role, model);
    const int activation = role == kTriangle ? 3 : role == kTetrahedron ? 2 : -1;
    table.damped = false;
    for (size_t k = 0; k < table.sources.size(); ++k) {
      const auto [e, corner] = table.sources[k];
      if (e < 0) continue;
      float p[kParameters[role]];
      for_parameters<role>(e, [&](int n, int array, int64_t at) {
        p[n] = array == activation ? 0.0f : arrays[static_cast<size_t>(array)][at];
      });
      float* const row = table.floats.data() + place_of(role, k);
      put_slot_numbers<role>(corner, p, dt, [row, lanes](int n, float value) {
        row[static_cast<size_t>(n) * lanes] = value;
      });
      table.damped |= p[kDampingParameter[role]] != 0.0f;
    }
  });
}

IndexRows particles_of_worlds(const Model& model) {
  std::vector<int32_t> world = model.particle_world.to_host();
  for (int32_t& w : world)
    if (w < 0) w = model.world_count() - 1;
  IndexRows rows;
  rows.build(world, model.world_count());
  return rows;
}

}  // namespace novaphy::vbd
