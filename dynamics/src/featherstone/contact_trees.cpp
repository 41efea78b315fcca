// Chooses the trees of a step with contacts on the CPU. Trees that touch only the world go to
// TreeSteps, and sleeping trees are skipped.
#include <algorithm>
#include <cstring>

#include "articulation_contact_kernels.h"
#include "articulation_step.h"
#include "contact_steps.h"
#include "novaphy/core/assert.h"

namespace novaphy {

namespace art = articulation;

namespace {

// The contacts of the trees that TreeSteps solves.
class TakenContacts : public TreeContacts {
 public:
  // `counts`: ContactSteps::isolated_
  TakenContacts(const ArticulationContactStepArguments& a, std::span<const int32_t> counts)
      : s_(a, 0), counts_(counts) {}

  int32_t count(int64_t tree) const override { return counts_[static_cast<size_t>(tree)]; }
  int32_t fill(int64_t tree, int32_t i, float* numbers, int32_t stride) override {
    int32_t link = 0;
    const art::TreeContact<float> contact =
        contact_of_tree(s_, static_cast<int32_t>(tree), place(tree, i), link);
    float values[sizeof(contact) / sizeof(float)];
    std::memcpy(values, &contact, sizeof(contact));
    for (const float value : values) {
      *numbers = value;
      numbers += stride;
    }
    return link;
  }
  void take(int64_t tree, int32_t i, const float* impulses, int32_t stride) override {
    const float along[3] = {impulses[0], impulses[stride], impulses[2 * stride]};
    const int32_t at = place(tree, i);
    take_contact(s_, at, art::contact_frame(s_.contacts.normal[s_.a.contacts[at]]), along);
  }
  void solved(int64_t tree, const art::IslandResult& result) override {
    node(tree).result = result;
  }

 private:
  IslandNode& node(int64_t tree) const { return s_.a.nodes[tree]; }
  int32_t place(int64_t tree, int32_t i) const {
    const int32_t group = s_.a.shapes.group_of_tree[tree];
    return s_.all.places[s_.a.contact_begin[group] + node(tree).begin + i];
  }
  const GroupStep s_;  // of any group: the functions used here do not depend on the group
  const std::span<const int32_t> counts_;
};

}  // namespace

// Makes TreeSteps step all trees that touch only the world. Returns whether other trees remain.
bool ContactSteps::take_trees(const FeatherstoneOptions& options, TreeSteps& lanes,
                              bool keeps_rates, const SleepingTrees* sleeping) {
  taken_.clear();
  for (size_t i = 0; i < isolated_.size(); ++i)
    if (isolated_[i] >= 0) taken_.push_back(static_cast<int32_t>(i));
  TakenContacts contacts(*last_, isolated_);
  lanes.step(last_->step, model_, taken_, options, &contacts, keeps_rates);
  return taken_.size() < (sleeping != nullptr ? sleeping->awake.size() : isolated_.size());
}

// Finds the islands of small groups, and their trees that touch only the world. A thread takes some
// groups through all of this.
void ContactSteps::open_groups() {
  const auto* const words = reinterpret_cast<const uint64_t*>(&*last_);
  const int64_t trees = articulations_.count();
  const int32_t *const begins = last_->of.tree_begin, *const list = last_->of.trees;
  constexpr int64_t kFewGroups = 64;  // a task of fewer groups than these has one
  for_chunks(groups_, groups_ < kFewGroups ? 1 : kTreeRows,
             [&](int64_t begin, int64_t end, int64_t) {
               for (int64_t group = begin; group < end; ++group) {
                 const std::span<const int32_t> of(list + begins[group], list + begins[group + 1]);
                 for (const int32_t tree : of)
                   articulation_contact_open.rows(words, trees, tree, tree + 1);
                 articulation_contact_islands.rows(words, groups_, group, group + 1);
                 for (const int32_t tree : of) find_isolated(tree, false);
               }
             });
}

void ContactSteps::find_isolated(int32_t tree, bool sleeps) {
  IslandNode& node = last_->of.nodes[tree];
  const bool isolated = !sleeps && node.coupled == 0 && node.root == tree && node.met == 0 &&
                        last_->step.status[tree] == 0;
  node.taken = isolated ? 1 : 0;
  isolated_[static_cast<size_t>(tree)] = isolated ? node.rows : -1;
}

// Marks the rows of sleeping trees as rows that do not move.
void ContactSteps::hold_some(const SleepingTrees& sleeping) {
  const auto* const all = reinterpret_cast<const ArticulationRows*>(articulations_.rows().data());
  rows_.assign(all, all + articulations_.count());
  for (size_t i = 0; i < rows_.size(); ++i)
    if (sleeping.asleep[i] != 0) rows_[i].moves = 0;
}

// Computes the frames of sleeping trees, because other trees may touch them.
void ContactSteps::open_some(const SleepingTrees& sleeping, const ContactArguments& contacts) {
  last_->step.in.rows = direct(rows_.data());
  const GroupStep any(*last_, 0);
  for (size_t i = 0; i < rows_.size(); ++i) {
    if (sleeping.asleep[i] == 0) continue;
    last_->step.status[i] = 0;
    start_node(any, static_cast<int32_t>(i));
  }
  met_.clear();
  const ContactShapes of = in_memory(shapes(contacts));
  for (int32_t contact = 0; contact < sleeping.contacts; ++contact) {
    art::ContactSide sides[2];
    contact_sides(of, contact, sides);
    for (const art::ContactSide& side : sides)
      if (side.tree >= 0 && sleeping.asleep[static_cast<size_t>(side.tree)] != 0)
        met_.push_back(side.tree);
  }
  std::sort(met_.begin(), met_.end());
  met_.erase(std::unique(met_.begin(), met_.end()), met_.end());
  run_some(articulation_contact_open, articulations_.count(), *last_, met_);
}

}  // namespace novaphy
