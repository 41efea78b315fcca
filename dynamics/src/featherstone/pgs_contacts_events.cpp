// Which contacts begin in a step.
#include <algorithm>
#include <cmath>

#include "contact_events.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr float kLeastApproach = 1e-3f;  // m/s
constexpr float kParallel = 0.999f;

// Whether contacts delay as one: of the same links, along the same normal.
bool hit_together(const ContactRows& c, const art::IslandContact& a, const art::IslandContact& b) {
  for (int side = 0; side < 2; ++side)
    if (a.sides[side].tree != b.sides[side].tree ||
        (a.sides[side].tree >= 0 && a.sides[side].link != b.sides[side].link))
      return false;
  return math::dot(c.normal[a.contact], c.normal[b.contact]) > kParallel;
}

}  // namespace

// The rates without impulses, for a while: impulses come back with other roundings, so only behind
// what the step writes.
std::vector<float> PgsContacts::free_slips() {
  push_impulses(-1.0f);
  std::vector<float> slips;
  for (const Row& row : rows_) slips.push_back(art::slip(row.solver, 0));
  push_impulses(1.0f);
  return slips;
}

ContactEvents PgsContacts::events(const ContactRows& contacts, const FeatherstoneOptions& options,
                                  const float* qd, bool continues) {
  ContactEvents found;
  if (rows_.empty()) return found;
  const art::ContactLaw<float> law = contact_law(options, 0.0f);
  const std::vector<float> slips = free_slips();
  found.touched.resize(static_cast<size_t>(count_));
  std::vector<char> hits(rows_.size());
  int32_t next = 0;
  for (size_t i = 0; i < rows_.size(); ++i) {
    const Row& row = rows_[i];
    const SeenContact now = art::seen_contact(contacts, row, law.cone);
    const auto count = continues ? static_cast<int32_t>(seen_.size()) : 0;
    const bool pushed = mode_of(seen_.data(), count, next, now) != 0;
    for (const Side& side : row.sides)
      if (side.tree >= 0 && row.solver.impulse[0] > 0.0f)
        found.touched[static_cast<size_t>(side.tree)] = 1;
    const float rest = std::max(kLeastApproach, std::abs(slips[i] - row.before));
    hits[i] =
        row.solver.impulse[0] > 0.0f && row.before < -rest && (row.target.bounce > 0.0f || !pushed);
    if (hits[i] != 0) found.hits.push_back(row.contact);
  }
  for (int64_t island = 0; island < static_cast<int64_t>(island_results_.size()); ++island) {
    ContactEvent event;
    std::vector<int32_t> begin(static_cast<size_t>(count_), -1);
    int32_t dofs = 0;
    for (int32_t i = 0; i < static_cast<int32_t>(count_); ++i) {
      if (island_of_tree_[static_cast<size_t>(find_root(i))] != island) continue;
      begin[static_cast<size_t>(i)] = dofs;
      dofs += trees_[i].dof_count;
      event.trees.push_back(i);
    }
    std::vector<const Row*> firsts;  // of the groups
    for (const int32_t i : island_rows_.items(island)) {
      const Row& row = rows_[static_cast<size_t>(i)];
      if (hits[static_cast<size_t>(i)] == 0) continue;
      const auto at = std::find_if(firsts.begin(), firsts.end(), [&](const Row* first) {
        return hit_together(contacts, *first, row);
      });
      const auto group = static_cast<size_t>(at - firsts.begin());
      if (at == firsts.end()) {
        firsts.push_back(&row);
        event.groups.emplace_back();
        event.groups.back().normal_push.resize(static_cast<size_t>(dofs));
        event.groups.back().push.resize(static_cast<size_t>(dofs));
      }
      ContactEvent::Group& to = event.groups[group];
      for (int side = 0; side < 2; ++side) {
        const art::RowSide<float>& s = row.solver.sides[side];
        if (s.width == 0 || row.sides[side].tree < 0) continue;
        const int32_t tree = row.sides[side].tree;
        const auto first = static_cast<size_t>(begin[static_cast<size_t>(tree)]);
        for (int32_t k = 0; k < trees_[tree].dof_count; ++k) {
          to.normal_push[first + static_cast<size_t>(k)] += s.jacobian[k] * row.solver.impulse[0];
          for (int r = 0; s.response != nullptr && r < 3; ++r)
            to.push[first + static_cast<size_t>(k)] -=
                s.response[r * s.width + k] * row.solver.impulse[r];
        }
      }
      event.lands = event.lands || (row.place.gap > 0.0f && !(row.target.bounce > 0.0f));
    }
    for (ContactEvent::Group& group : event.groups) {
      float speed = 0.0f;
      for (const int32_t tree : event.trees)
        for (int32_t k = 0; k < trees_[tree].dof_count; ++k)
          speed += group.normal_push[static_cast<size_t>(begin[static_cast<size_t>(tree)] + k)] *
                   qd[trees_[tree].first_dof + k];
      group.approach = std::abs(speed);
    }
    if (!event.groups.empty()) found.events.push_back(std::move(event));
  }
  return found;
}

}  // namespace novaphy
