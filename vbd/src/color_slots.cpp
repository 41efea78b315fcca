#include "color_slots.h"

#include <algorithm>
#include <numeric>

#include "element_arrays.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"

namespace novaphy::vbd {
namespace {

// Returns whether an element has an effect: a coefficient of its material is not 0.
template <class Element>
bool acts(const Model& m, size_t e) {
  bool any = false;
  Element::for_arrays(m, [&](const char*, const Array& array, int columns, ArrayUse use) {
    const float* const row = static_cast<const float*>(array.raw()) + e * array.width();
    if (use == kMaterial)
      any |= std::any_of(row, row + columns, [](float value) { return value != 0.0f; });
  });
  return any;
}

// Calls visit(RoleIs<first role>(), element, corners) for each element with an effect.
template <class Visit>
void visit_elements(const Model& m, const Visit& visit) {
  for_each_kind([&](auto is) {
    using Element = typename decltype(is)::Slot;
    Element::with_indices(m, [&](const char*, const Array& indices) {
      const auto* corners = static_cast<const int32_t*>(indices.raw());
      for (size_t e = 0; e < indices.rows(); ++e, corners += Element::kCorners)
        if (acts<Element>(m, e) && std::none_of(corners, corners + Element::kCorners,
                                                [](int32_t corner) { return corner < 0; }))
          visit(is, static_cast<int32_t>(e), corners);
    });
  });
}

// Checks that the indices of particles exist, and that material columns which no force uses are 0.
template <class Element>
void check_elements(const Model& m) {
  Element::with_indices(m, [&m](const char* name, const Array& indices) {
    const auto* const corners = static_cast<const int32_t*>(indices.raw());
    for (size_t k = 0; k < indices.rows() * Element::kCorners; ++k)
      require((corners[k] >= 0 && corners[k] < m.particle_count()) ||
                  (Element::kMayLackCorners && corners[k] == -1),
              ErrorKind::Index, "SolverVBD: model.", name, "[", k / Element::kCorners,
              "]: expected particles from 0 to ", m.particle_count() - 1,
              Element::kMayLackCorners ? ", or -1" : "", ", got ", corners[k]);
  });
  Element::for_arrays(m, [](const char* name, const Array& array, int columns, ArrayUse use) {
    const auto* const values = static_cast<const float*>(array.raw());
    const size_t width = array.width(), count = array.rows() * width;
    for (size_t k = 0; use == kMaterial && k < count; ++k)
      require(k % width < static_cast<size_t>(columns) || values[k] == 0.0f,
              ErrorKind::NotImplemented, "SolverVBD: model.", name, "[", k / width,
              "]: ", Element::kUnread, " are not supported, expected 0, got ", values[k]);
  });
}

void check_control(const Model& model) {
  const std::vector<float> control = model.particle_spring_control.to_host();
  for (size_t e = 0; e < control.size(); ++e)
    require(control[e] == 0.0f, ErrorKind::NotImplemented,
            "SolverVBD: model.particle_spring_control[", e,
            "]: expected 0, because no force of VBD uses it, got ", control[e]);
}

}  // namespace

void ColorSlots::find_kinematic(const Model& model) {
  const int32_t* flags = model.particle_flags.data();
  const float* inv_mass = model.particle_inv_mass.data();
  is_kinematic_.assign(static_cast<size_t>(model.particle_count()), 0);
  kinematic_.clear();
  for (int32_t p = 0; p < model.particle_count(); ++p) {
    if (has_flag(flags[p], ParticleFlags::ACTIVE) && inv_mass[p] > 0.0f) continue;
    is_kinematic_[static_cast<size_t>(p)] = 1;
    kinematic_.push_back(p);
  }
}

// Joins the particles of each element that move, and marks the components without kinematic ones.
void ColorSlots::find_components(const Model& model) {
  component_.resize(is_kinematic_.size());
  std::iota(component_.begin(), component_.end(), 0);
  const auto root = [this](int32_t p) {
    const auto up = [this](int32_t of) -> int32_t& { return component_[static_cast<size_t>(of)]; };
    while (up(p) != p) p = up(p) = up(up(p));
    return p;
  };
  std::vector<bool> is_tied(component_.size(), false);
  visit_elements(model, [&](auto is, int32_t, const int32_t* corners) {
    for (int c = 0; c < decltype(is)::Slot::kCorners; ++c)
      for (int d = 0; d < c; ++d) {
        if (is_kinematic(corners[c]) || is_kinematic(corners[d])) {
          for (const int32_t p : {corners[c], corners[d]}) is_tied[static_cast<size_t>(p)] = true;
          continue;
        }
        const int32_t first = root(corners[c]), second = root(corners[d]);
        component_[static_cast<size_t>(std::max(first, second))] = std::min(first, second);
      }
  });
  std::vector<int32_t> number(component_.size());  // of the components named by first particles
  is_free_.clear();
  for (int32_t p = 0; p < model.particle_count(); ++p) {
    const auto first = static_cast<size_t>(root(p)), at = static_cast<size_t>(p);
    if (first == at && !is_kinematic(p)) {
      number[at] = component_count();
      is_free_.push_back(1);
    }
    component_[at] = static_cast<int32_t>(first);
  }
  for (size_t p = 0; p < number.size(); ++p) {
    component_[p] = is_kinematic_[p] != 0 ? -1 : number[static_cast<size_t>(component_[p])];
    if (is_kinematic_[p] == 0 && is_tied[p]) is_free_[static_cast<size_t>(component_[p])] = 0;
  }
}

// Collects the slots of every particle, by role, in the order of the elements.
void ColorSlots::collect(const Model& model) {
  const auto count = static_cast<size_t>(model.particle_count());
  for (Table& table : tables_) table.particle_begin.assign(count + 1, 0);
  const auto visit = [&](const auto& take) {
    visit_elements(model, [&](auto is, int32_t e, const int32_t* corners) {
      using Element = typename decltype(is)::Slot;
      for (int c = 0; c < Element::kCorners; ++c)
        if (!is_kinematic(corners[c]))
          take(is.role + Element::slot_of(model, e, c), static_cast<size_t>(corners[c]),
               Source{e, c});
    });
  };
  visit([&](int role, size_t p, Source) { ++tables_[role].particle_begin[p + 1]; });
  std::vector<int64_t> next[kRoles];
  for (int role = 0; role < kRoles; ++role) {
    Table& table = tables_[role];
    std::partial_sum(table.particle_begin.begin(), table.particle_begin.end(),
                     table.particle_begin.begin());
    table.of_particles.resize(static_cast<size_t>(table.particle_begin.back()));
    next[role] = table.particle_begin;
  }
  visit([&](int role, size_t p, Source source) {
    tables_[role].of_particles[static_cast<size_t>(next[role][p]++)] = source;
  });
  // checks that the slots of each particle end where the slots of the next particle begin
  for (int role = 0; role < kRoles; ++role)
    NOVAPHY_ASSERT(std::equal(next[role].begin(), next[role].end() - 1,
                              tables_[role].particle_begin.begin() + 1));
}

void ColorSlots::find_conflicts(const std::vector<int32_t>& colors, const Model& model) {
  has_conflicts_ = false;
  visit_elements(model, [&](auto is, int32_t, const int32_t* corners) {
    for (int c = 0; c < decltype(is)::Slot::kCorners; ++c)
      for (int d = 0; d < c; ++d)
        has_conflicts_ |=
            corners[c] != corners[d] && !is_kinematic(corners[c]) && !is_kinematic(corners[d]) &&
            colors[static_cast<size_t>(corners[c])] == colors[static_cast<size_t>(corners[d])];
  });
}

// Makes the groups of each color. The particles of a color are sorted by their number of slots, so
// that the lanes of a group have similar numbers of slots.
void ColorSlots::make_groups(const std::vector<int32_t>& colors) {
  std::vector<std::vector<int32_t>> of_color;
  for (size_t p = 0; p < colors.size(); ++p) {
    if (is_kinematic_[p] != 0) continue;
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

template <class Slot>
void ColorSlots::lay_slots(Table& table, const int32_t* corners, size_t elements) {
  const auto lanes = static_cast<size_t>(lanes_);
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
      for (size_t lane = 0; lane < lanes; ++lane)
        table.sources.push_back(
            s < count(lane) ? table.of_particles[static_cast<size_t>(first(lane) + s)] : Source{});
      const Source* const of = &table.sources[table.sources.size() - lanes];
      for (int k = 0; k < Slot::kCorners - 1; ++k)
        for (size_t lane = 0; lane < lanes; ++lane)
          table.ints.push_back(of[lane].element < 0
                                   ? particle[lane]
                                   : corners[of[lane].element * Slot::kCorners +
                                             Slot::other_corner(of[lane].corner, k)]);
    }
    table.begin.push_back(table.begin.back() + most);
  }
  NOVAPHY_ASSERT(table.begin.size() == filled_.size() + 1);
  NOVAPHY_ASSERT(table.sources.size() == static_cast<size_t>(table.begin.back()) * lanes);
  table.places.assign(elements * Slot::kCorners, -1);
  for (size_t k = 0; k < table.sources.size(); ++k)
    if (const auto [e, corner] = table.sources[k]; e >= 0)
      table.places[static_cast<size_t>(e * Slot::kCorners + corner)] = static_cast<int64_t>(k);
}

void ColorSlots::build(const Model& model, int lanes) {
  lanes_ = lanes;
  for_each_kind([&model](auto is) { check_elements<typename decltype(is)::Slot>(model); });
  check_control(model);
  const std::vector<int32_t> colors = model.particle_colors.to_host();
  for (size_t p = 0; p < colors.size(); ++p)
    require(colors[p] >= 0, ErrorKind::Value, "SolverVBD: model: particle ", p,
            " has no color; call ModelBuilder.color() (or set_coloring) before finalize");
  find_kinematic(model);
  find_conflicts(colors, model);
  find_components(model);
  collect(model);
  make_groups(colors);
  floats_begin_.assign(1, 0);
  for_roles([&](auto is) {
    using Slot = typename decltype(is)::Slot;
    Table& table = tables_[is.role];
    Slot::with_indices(model, [&](const char*, const Array& indices) {
      lay_slots<Slot>(table, static_cast<const int32_t*>(indices.raw()), indices.rows());
    });
    table.floats.assign(table.sources.size() * static_cast<size_t>(kFloats[is.role]), 0.0f);
    floats_begin_.push_back(floats_begin_.back() + static_cast<int64_t>(table.floats.size()));
  });
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
    using Slot = typename decltype(is)::Slot;
    Table& table = tables_[is.role];
    const auto arrays = parameters_on_host<Slot>(model);
    table.damped = Slot::kIsAlwaysDamped;
    for (size_t k = 0; k < table.sources.size(); ++k) {
      const auto [e, corner] = table.sources[k];
      if (e < 0) continue;
      float p[Slot::kParameters];
      for_parameters<Slot>(e, [&](int n, int array, int64_t at) {
        const float* const values = arrays[static_cast<size_t>(array)];
        p[n] = values != nullptr ? values[at] : 0.0f;
      });
      float* const row = table.floats.data() + offset_of(is.role, k);
      Slot::put_numbers(corner, p, dt, [row, lanes](int n, float value) {
        row[static_cast<size_t>(n) * lanes] = value;
      });
      table.damped |= p[Slot::kDampingParameter] != 0.0f;
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
