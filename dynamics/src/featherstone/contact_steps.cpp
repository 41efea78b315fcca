#include "contact_steps.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "contact_launches.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/on_host.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr size_t kKeptNumbers = sizeof(art::KeptContact) / sizeof(float),
                 kNodeNumbers = sizeof(IslandNode) / sizeof(int32_t),
                 kLinkNumbers = sizeof(ContactLink) / sizeof(int32_t);

int64_t numbers(int64_t bytes) { return bytes / static_cast<int64_t>(sizeof(float)); }

// Finds the group of each articulation from its world, and returns the number of groups.
int32_t find_groups(const Model& m, std::vector<int32_t>& groups) {
  const OnHost<int32_t> start(m.articulation_start), world(m.joint_world);
  bool one = false;
  for (size_t i = 0; i < groups.size(); ++i) {
    groups[i] = world[static_cast<size_t>(start[i])];
    one = one || groups[i] < 0;
  }
  if (one) {
    std::fill(groups.begin(), groups.end(), 0);
    return 1;
  }
  std::vector<int32_t> worlds = groups;  // worlds that have articulations
  std::sort(worlds.begin(), worlds.end());
  worlds.erase(std::unique(worlds.begin(), worlds.end()), worlds.end());
  for (int32_t& group : groups)
    group = static_cast<int32_t>(std::lower_bound(worlds.begin(), worlds.end(), group) -
                                 worlds.begin());
  return static_cast<int32_t>(worlds.size());
}

}  // namespace

ContactSteps::ContactSteps(const Model& m, const Articulations& articulations)
    : model_(m),
      articulations_(articulations),
      polytopes_(m),
      tree_stride_(numbers(island_tree_bytes(articulations.max_links(), articulations.max_dofs()))),
      adjoint_tree_stride_(
          numbers(island_adjoint_bytes(articulations.max_links(), articulations.max_dofs()))),
      contact_stride_(numbers(island_contact_bytes(articulations.max_dofs()))),
      none_({}, m.device()),
      adjoint_stride_(numbers(adjoint_contact_bytes(articulations.max_dofs()))) {
  const UntrackedScope untracked;
  const Device device = m.device();
  const std::vector<int32_t> rows = articulations.rows().to_host(),
                             links = articulations.links().to_host(),
                             dof_parent = articulations.dof_parent().to_host();
  const auto count = static_cast<size_t>(articulations.count());
  const auto* const all_rows = reinterpret_cast<const ArticulationRows*>(rows.data());
  const auto* const all_links = reinterpret_cast<const art::Link*>(links.data());
  std::vector<int32_t> sides(2 * static_cast<size_t>(m.body_count()), -1), moved_by;
  for (size_t i = 0; i < count; ++i) {
    art::Tree<float> tree;
    tree.mimics = all_rows[i].mimics;
    tree.joints_in_a_row = all_rows[i].joints_in_a_row;
    has_long_trees_ = has_long_trees_ || !art::has_matrix(tree);
    tree.link_count = all_rows[i].link_count;
    tree.dof_count = all_rows[i].dof_count;
    tree.links = all_links + all_rows[i].first_link;
    tree.dof_parent = dof_parent.data() + all_rows[i].first_dof;
    tree.first_dof = all_rows[i].first_dof;
    for (int32_t k = 0; k < tree.link_count; ++k) {
      moved_by.push_back(art::moving_dofs(tree, k));
      if (tree.links[k].body < 0) continue;
      const auto body = 2 * static_cast<size_t>(tree.links[k].body);
      sides[body] = static_cast<int32_t>(i);
      sides[body + 1] = k;
    }
  }
  std::vector<int32_t> group_of_tree(count);
  groups_ = find_groups(m, group_of_tree);
  IndexRows lists;
  lists.build(group_of_tree, static_cast<int32_t>(groups_));
  fuses_ = groups_ == articulations.count() && tree_stride_ <= numbers(kIslandMemory);
  side_of_body_ = DeviceArray<int32_t>::from_host(sides, device, 2);
  moved_by_ = DeviceArray<int32_t>::from_host(moved_by, device);
  group_of_tree_ = DeviceArray<int32_t>::from_host(group_of_tree, device);
  isolated_.resize(count);
  tree_begin_ = DeviceArray<int32_t>::from_host(lists.begins(), device);
  trees_ = DeviceArray<int32_t>::from_host(lists.all(), device);
  nodes_ = DeviceArray<int32_t>(count, device, kNodeNumbers);
  const auto groups = static_cast<size_t>(groups_);
  std::vector<int64_t> dofs(groups);
  for (size_t i = 0; i < count; ++i)
    group_dofs_ =
        std::max(group_dofs_, dofs[static_cast<size_t>(group_of_tree[i])] += all_rows[i].dof_count);
  contact_begin_ = DeviceArray<int32_t>(groups + 1, device);
  kept_begin_ = DeviceArray<int32_t>(groups + 1, device);
  kept_dt_ = DeviceArray<float>(1, device);
  kept_friction_ = DeviceArray<float>(static_cast<size_t>(m.joint_dof_count()), device);
  now_friction_ = DeviceArray<float>(static_cast<size_t>(m.joint_dof_count()), device);
}

art::ContactRows contact_rows(const Contacts* contacts) {
  if (contacts == nullptr) return {};
  const Contacts& c = *contacts;
  return {filled_rows(*c.rigid_contact_count.data(), c.rigid_contact_max(),
                      c.rigid_contact_shape0.data()),
          c.rigid_contact_shape0.data(),
          c.rigid_contact_shape1.data(),
          c.rigid_contact_point_id.data(),
          c.rigid_contact_point0.data(),
          c.rigid_contact_point1.data(),
          c.rigid_contact_normal.data(),
          c.rigid_contact_margin0.data(),
          c.rigid_contact_margin1.data()};
}

ContactArguments contact_arguments(const Contacts& c) {
  return {.at = {.shape0 = c.rigid_contact_shape0,
                 .shape1 = c.rigid_contact_shape1,
                 .point0 = c.rigid_contact_point0,
                 .point1 = c.rigid_contact_point1,
                 .normal = c.rigid_contact_normal,
                 .margin0 = c.rigid_contact_margin0,
                 .margin1 = c.rigid_contact_margin1},
          .count = c.rigid_contact_count,
          .most = c.rigid_contact_max(),
          .point_id = c.rigid_contact_point_id,
          .force = c.rigid_contact_force};
}

ContactArguments contact_arguments(const art::ContactRows& c) {
  return {.at = {.shape0 = direct(c.shape0),
                 .shape1 = direct(c.shape1),
                 .point0 = direct(c.point0),
                 .point1 = direct(c.point1),
                 .normal = direct(c.normal),
                 .margin0 = direct(c.margin0),
                 .margin1 = direct(c.margin1)},
          .count = direct(&c.count),
          .most = c.count};
}

void ContactSteps::reserve(int64_t contacts) {
  if (contacts <= capacity_) return;
  const Device device = model_.device();
  const auto count = static_cast<size_t>(contacts);
  group_ = DeviceArray<int32_t>(count, device);
  contacts_ = DeviceArray<int32_t>(count, device);
  places_ = DeviceArray<int32_t>(count, device);
  chain_ = DeviceArray<int32_t>(count, device, kLinkNumbers);
  now_ = DeviceArray<float>(count, device, kKeptNumbers);
  kept_ = DeviceArray<float>(count, device, kKeptNumbers);
  memory_ = DeviceArray<float>(count * static_cast<size_t>(contact_stride_), device);
  kept_begin_ = DeviceArray<int32_t>(static_cast<size_t>(groups_) + 1, device);
  capacity_ = contacts;
}

void ContactSteps::reserve_trees(int64_t stride) {
  const auto floats = static_cast<size_t>(articulations_.count() * stride);
  if (floats <= trees_memory_.size()) return;
  const UntrackedScope untracked;
  trees_memory_ = DeviceArray<float>(floats, model_.device());
}

bool ContactSteps::has_friction() {
  if (!friction_stamp_.matches(model_.joint_friction)) {
    const UntrackedScope untracked;
    const OnHost<float> friction(model_.joint_friction);
    has_friction_ = std::any_of(friction.data(), friction.data() + friction.size(),
                                [](float x) { return x > 0.0f; });
    friction_stamp_.set(model_.joint_friction);
  }
  return has_friction_;
}

bool ContactSteps::has_rows(const Contacts* contacts) {
  const bool friction = has_friction();
  bool touches = contacts != nullptr && contacts->rigid_contact_max() > 0;
  if (model_.device().is_cpu())
    touches = touches && *contacts->rigid_contact_count.data() > 0;
  else
    touches = touches || capacity_ > 0;
  if (groups_ > 0 && (friction || touches)) return true;
  if (has_run_) forget_impulses();
  return has_run_ = false;
}

void ContactSteps::read_polytopes() {
  const UntrackedScope untracked;
  polytopes_.update();
}

void ContactSteps::forget_impulses() {
  kept_begin_.zero();
  kept_friction_.zero();
}

ContactShapes ContactSteps::shapes(const ContactArguments& contacts) const {
  return {.at = contacts.at,
          .shape_body = model_.shape_body,
          .side_of_body = Untyped(side_of_body_),
          .group_of_tree = group_of_tree_,
          .shapes = model_.shape_count(),
          .bodies = model_.body_count()};
}

// Lists the contacts of each group in their order. The host leaves out the empty rows at the end.
void ContactSteps::list_contacts(const ContactArguments& contacts, const ContactRecord& record,
                                 bool on_host, const SleepingTrees* sleeping) const {
  const ArticulationContactGroupArguments a = {
      .shapes = shapes(contacts),
      .rows = sleeping != nullptr ? Given<ArticulationRows>(direct(rows_.data()))
                                  : Given<ArticulationRows>(Untyped(articulations_.rows())),
      .count = contacts.count,
      .group = group_,
      .force = contacts.force,
      .impulses = record.impulses};
  int64_t rows = contacts.most;
  if (on_host) {
    constexpr int64_t kChunk = 128;
    const ArticulationContactGroupArguments here = in_memory(a);
    rows = std::clamp<int64_t>(*here.count, 0, rows);
    run_rows(articulation_contact_group, rows, here, kChunk);
  } else {
    run(contact_kernels().contact_group, rows, a);
  }
  run(incidence(), groups_,
      {.table = group_, .slots = rows, .offsets = contact_begin_, .items = contacts_});
}

ContactGroupArguments ContactSteps::groups(const ContactArguments& contacts,
                                           const FeatherstoneOptions& o,
                                           const ContactRecord& record,
                                           const DeviceArray<float>& memory, int64_t stride) const {
  return {.shapes = shapes(contacts),
          .mu = model_.shape_material_mu,
          .restitution = model_.shape_material_restitution,
          .ke = model_.shape_material_ke,
          .kd = model_.shape_material_kd,
          .mixing = model_.shape_mixing,
          .joint_friction = model_.joint_friction,
          .tree_begin = tree_begin_,
          .trees = trees_,
          .contact_begin = contact_begin_,
          .contacts = contacts_,
          .shape_type = model_.shape_type,
          .shape_transform = model_.shape_transform,
          .shape_scale = model_.shape_scale,
          .views = record.found ? Untyped(polytopes_.views()) : Untyped(nullptr),
          .view_of_shape = record.found ? Untyped(polytopes_.of_shape()) : Untyped(nullptr),
          .erp = o.pgs_erp,
          .slop = o.pgs_slop,
          .cfm = o.pgs_cfm,
          .max_depenetration = o.max_depenetration_velocity,
          .restitution_threshold = o.restitution_threshold,
          .compliant = o.compliant_contacts,
          .cone = o.friction_cone == FrictionCone::Cone,
          .found = record.found,
          .chain = Untyped(chain_),
          .nodes = Untyped(nodes_),
          .memory = memory,
          .contact_stride = stride};
}

ArticulationContactStepArguments ContactSteps::step_arguments(const ArticulationStepArguments& of,
                                                              const ContactArguments& contacts,
                                                              const FeatherstoneOptions& o,
                                                              const ContactRecord& record,
                                                              bool continues, bool lanes) const {
  const Untyped none(nullptr);
  const auto noted = [&](const Array& array) { return record.notes ? Untyped(array) : none; };
  return {.step = of,
          .of = groups(contacts, o, record, memory_, contact_stride_),
          .point_id = contacts.point_id,
          .moved_by = moved_by_,
          .tolerance = o.pgs_tolerance,
          .most_sweeps = o.pgs_iterations,
          .warm_start = o.warm_start,
          .most_isolated = record.records ? 0 : art::kMostTreeContacts,
          .kept_begin = kept_begin_,
          .kept = Untyped(kept_),
          .kept_dt = kept_dt_,
          .kept_friction = kept_friction_,
          .now_friction = now_friction_,
          .now = Untyped(now_),
          .places = places_,
          .force = contacts.force,
          .impulses = record.impulses,
          .friction_impulses = record.friction,
          .notes = noted(notes_),
          .seen = noted(seen_),
          .seen_before = noted(seen_before_),
          .seen_begin = noted(seen_begin_),
          .by_restitution = record.by_restitution,
          .continues = continues,
          .lanes = lanes};
}

void ContactSteps::step(const ArticulationStepArguments& of, const ContactArguments& contacts,
                        const FeatherstoneOptions& o, const ContactRecord& record, TreeSteps* lanes,
                        const SleepingTrees* sleeping) {
  require(
      lanes != nullptr || !has_long_trees_, ErrorKind::NotImplemented,
      "step: contacts, or dry friction of joints, of a model with an articulation of more than ",
      art::kMatrixJoints, " joints in a row: expected the model on the cpu, got it on ",
      model_.device().str());
  has_run_ = true;
  if (record.found) read_polytopes();
  reserve(contacts.most);
  const bool forgets = record.notes && reserve_notes();
  const ContactKernels& k = contact_kernels();
  if (sleeping != nullptr) hold_some(*sleeping);
  list_contacts(contacts, record, lanes != nullptr, sleeping);
  const bool fuses = fuses_ && lanes == nullptr;
  const int64_t trees = articulations_.count();
  reserve_trees(fuses ? numbers(kIslandMemory) : tree_stride_);
  ArticulationContactStepArguments a =
      step_arguments(of, contacts, o, record, record.continues && !forgets, lanes != nullptr);
  a.step.workspace = trees_memory_;
  a.step.stride = fuses ? 0 : tree_stride_;
  if (fuses) {
    run(k.contact_step, groups_ * kTeamThreads, a);
  } else {
    if (lanes != nullptr) last_ = in_memory(a);
    const auto launch = [&](const auto& kernel, const auto& function, int64_t n, bool all = false) {
      if (sleeping != nullptr && !all)
        run_some(function, n, *last_, sleeping->awake);
      else if (lanes != nullptr)
        run_rows(function, n, *last_);
      else
        run(kernel, n, a);
    };
    if (sleeping != nullptr) open_some(*sleeping, contacts);
    if (lanes != nullptr && sleeping == nullptr && trees <= groups_ * kTreeRows) {
      open_groups();
    } else {
      launch(k.contact_open, articulation_contact_open, trees);
      launch(k.contact_islands, articulation_contact_islands, groups_, true);
      for (int32_t i = 0; lanes != nullptr && i < trees; ++i)
        find_isolated(i, sleeping != nullptr && sleeping->asleep[static_cast<size_t>(i)] != 0);
    }
    const bool some = lanes == nullptr || take_trees(o, *lanes, record.records, sleeping);
    if (some && lanes != nullptr) launch(k.contact_start, articulation_contact_start, trees);
    if (some && lanes != nullptr) islands_.solve(*last_, trees);
    if (some) launch(k.contact_solve, articulation_contact_solve, trees);
    if (some) launch(k.contact_finish, articulation_contact_finish, trees);
    if (record.notes) launch(k.contact_notes, articulation_contact_notes, groups_, true);
  }
  if (!o.warm_start || (lanes != nullptr && has_failed())) return;
  if (lanes != nullptr && !record.notes)
    take_kept(of.in.dt);
  else
    keep(contacts.most, of.in.dt);
}

// The same as `keep` on the host, without copies: the lists of both steps change places.
void ContactSteps::take_kept(const Number<float>& dt) {
  std::swap(kept_, now_);
  std::swap(kept_begin_, contact_begin_);
  *kept_dt_.mutable_data() = dt.value;
  if (!has_friction_) return;
  std::copy_n(now_friction_.data(), now_friction_.rows(), kept_friction_.mutable_data());
}

void ContactSteps::keep(int64_t contacts, const Number<float>& dt) {
  const int64_t dofs = model_.joint_dof_count();
  run(contact_kernels().contact_keep, std::max({contacts, groups_ + 1, dofs}),
      {.begin = contact_begin_,
       .now = Untyped(now_),
       .now_friction = now_friction_,
       .kept_begin = kept_begin_,
       .kept = Untyped(kept_),
       .kept_friction = kept_friction_,
       .kept_dt = kept_dt_,
       .dt = dt,
       .groups = groups_,
       .dofs = dofs});
}

std::span<IslandNode> ContactSteps::nodes_here() const {
  return {reinterpret_cast<IslandNode*>(nodes_.range()->data()), nodes_.rows()};
}
bool ContactSteps::has_failed() const {
  const int32_t* const status = last_->step.status;
  return std::any_of(status, status + articulations_.count(), [](int32_t s) { return s != 0; });
}

}  // namespace novaphy
