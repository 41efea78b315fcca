// The momentum of free components at the end of a step.
//
// Iterations end before the forces of a contact balance, so both sides together can gain momentum.
// Components that touched each other form a group. A group gets back its momentum by one
// translation, which keeps its gaps. A component that is not alone in its world is a group, even if
// it touched nothing.
#include <algorithm>
#include <numeric>

#include "self_contact.h"

namespace novaphy::vbd {

void SelfContact::make_groups() {
  const int32_t tied = slots_.component_count();
  apart_.resize(index(tied + 1));
  std::iota(apart_.begin(), apart_.end(), 0);
  for (int32_t c = 0; c < tied; ++c)
    if (!slots_.is_free(c)) apart_[index(c)] = tied;
  std::vector<int32_t> part(index(worlds_), -1);
  std::vector<char> has_several(index(worlds_), 0);
  for (const int32_t p : vertices_) {
    const size_t w = index(world_[index(p)]);
    if (part[w] < 0) part[w] = part_of(p);
    if (part[w] != part_of(p)) has_several[w] = 1;
  }
  has_others_.assign(apart_.size(), 0);
  for (const int32_t p : vertices_)
    has_others_[index(part_of(p))] = has_several[index(world_[index(p)])];
  shift_.resize(apart_.size());
  mass_.resize(apart_.size());
  is_far_.resize(index(worlds_));
}

// Returns the component of a particle, or the entry behind the last for a kinematic particle.
int32_t SelfContact::part_of(int32_t p) const {
  const int32_t c = slots_.components()[index(p)];
  return c < 0 ? slots_.component_count() : c;
}

// Returns the last component of the group of component c.
int32_t SelfContact::group_of(int32_t c) {
  while (next_[index(c)] != c) c = next_[index(c)] = next_[index(next_[index(c)])];
  return c;
}

// Joins the groups of the particles of a pair. Returns whether there were several.
bool SelfContact::join(const SurfacePair& pair) {
  bool any = false;
  for (const int32_t p : pair.particle) {
    is_balanced_[index(part_of(p))] = 1;
    const auto [first, last] =
        std::minmax({group_of(part_of(pair.particle[0])), group_of(part_of(p))});
    any = any || first != last;
    next_[index(first)] = last;
  }
  return any;
}

void SelfContact::balance(const Given& given) {
  const int32_t tied = slots_.component_count();
  for (int32_t p = 0; given.begin != nullptr && p < model_.particle_count(); ++p)
    if (given.begin[p + 1] != given.begin[p]) next_[index(group_of(part_of(p)))] = tied;
  std::fill(is_far_.begin(), is_far_.end(), 0);
  for (const bool searches : {false, true}) {
    do {
      set_shifts();
    } while (meets_obstacle(searches));
  }
  for (int32_t p = 0; p < model_.particle_count(); ++p) {
    const Vec3d& shift = shift_[index(part_of(p))];
    if (math::dot(shift, shift) == 0.0) continue;
    const Vec4f &start = rows_.start[index(p)], &before = rows_.moved[index(p)];
    const Vec3f moved = Vec3f{before.x, before.y, before.z} + narrow(shift);
    rows_.moved[index(p)] = {moved.x, moved.y, moved.z, 0.0f};
    rows_.x[index(p)] = {start.x + moved.x, start.y + moved.y, start.z + moved.z, 0.0f};
  }
}

// Computes the translation of each component that gives its group its momentum.
void SelfContact::set_shifts() {
  std::fill(shift_.begin(), shift_.end(), Vec3d{});
  std::fill(mass_.begin(), mass_.end(), 0.0);
  for (int32_t p = 0; p < model_.particle_count(); ++p) {
    const size_t g = index(group_of(part_of(p)));
    if (is_balanced_[index(part_of(p))] == 0 || g + 1 == mass_.size()) continue;
    const double m = wide(model_.particle_mass.data()[p]);
    shift_[g] = shift_[g] + (wide(rows_.target[index(p)]) - at(p)) * m;
    mass_[g] += m;
  }
  for (size_t g = 0; g < mass_.size(); ++g)
    if (mass_[g] > 0.0) shift_[g] = shift_[g] * (1.0 / mass_[g]);
  for (int32_t c = 0; c < slots_.component_count(); ++c)
    shift_[index(c)] = shift_[index(group_of(c))];
}

// Joins the groups of surfaces that the translations would bring together. Returns whether there
// were any. Only the difference to the first translation of a world counts. Pairs that no search
// found are farther apart than the radius. Worlds with differences of more than a quarter of this
// wait for the pass that `searches`.
bool SelfContact::meets_obstacle(bool searches) {
  std::vector<const Vec3d*> first(index(worlds_), nullptr);
  const auto shift = [&](int32_t p) {
    return shift_[index(part_of(p))] - *first[index(world_[index(p)])];
  };
  for (const int32_t p : vertices_) {
    const size_t w = index(world_[index(p)]);
    if (first[w] == nullptr) first[w] = &shift_[index(part_of(p))];
    if (length_of(shift(p)) > 0.25 * wide(radius_)) is_far_[w] = 1;
  }
  const bool any = std::find(is_far_.begin(), is_far_.end(), 1) != is_far_.end();
  if (searches && !any) return false;
  const auto is_due = [&](int32_t p) {
    return (is_far_[index(world_[index(p)])] != 0) == searches;
  };
  if (searches) {
    for (const int32_t p : vertices_) {
      const size_t i = index(p);
      if (!is_due(p)) continue;
      origin_[i] = reference_[i] = rows_.x[i];
      wish_[i] = narrow_row(at(p) + shift(p));
    }
    for (int32_t w = 0; w < worlds_; ++w)
      if (is_far_[index(w)] != 0) set_reach(w);
    detect(is_far_);
  }
  bool meets = false;
  for (const int32_t p : vertices_) {
    if (!is_due(p)) continue;
    const Vec3d x = at(p), to = x + shift(p);
    const Plane* plane = planes_of_.data() + pairs_of_.begins()[index(p)];
    for (const int32_t item : pairs_of_.items(p)) {
      const bool is_safe = plane->height(to) >= std::min(plane->height(x), 0.0);
      if (!is_safe && join(pairs_[index(item / 4)])) meets = true;
      ++plane;
    }
  }
  return meets;
}

}  // namespace novaphy::vbd
