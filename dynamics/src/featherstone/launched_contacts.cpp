#include "launched_contacts.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "articulation_contact_kernels.h"
#include "articulation_contact_vjp_kernels.h"
#include "contact_launches.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/on_host.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr size_t kKeptNumbers = sizeof(art::KeptContact) / sizeof(float),
                 kNodeNumbers = sizeof(IslandNode) / sizeof(int32_t),
                 kLinkNumbers = sizeof(ContactLink) / sizeof(int32_t),
                 kNoteNumbers = sizeof(art::BranchNotes) / sizeof(int32_t);
constexpr int64_t kSomeNotes = 128;  // rows that add up the notes of groups

int64_t numbers(int64_t bytes) { return bytes / static_cast<int64_t>(sizeof(float)); }

// The group of each articulation, from its world; how many there are.
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
  std::vector<int32_t> worlds = groups;  // those with articulations
  std::sort(worlds.begin(), worlds.end());
  worlds.erase(std::unique(worlds.begin(), worlds.end()), worlds.end());
  for (int32_t& group : groups)
    group = static_cast<int32_t>(std::lower_bound(worlds.begin(), worlds.end(), group) -
                                 worlds.begin());
  return static_cast<int32_t>(worlds.size());
}

}  // namespace

LaunchedContacts::LaunchedContacts(const Model& m, const Articulations& articulations)
    : model_(m),
      articulations_(articulations),
      tree_stride_(numbers(island_tree_bytes(articulations.max_links(), articulations.max_dofs()))),
      adjoint_tree_stride_(
          numbers(island_adjoint_bytes(articulations.max_links(), articulations.max_dofs()))),
      contact_stride_(numbers(island_contact_bytes(articulations.max_dofs()))),
      none_({}, m.device()),
      adjoint_stride_(numbers(adjoint_contact_bytes(articulations.max_dofs()))) {
  const Unobserved unobserved;
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
    tree.followers = all_rows[i].followers;
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
  on_stack_ = static_cast<size_t>(groups_) == count &&
              tree_stride_ * static_cast<int64_t>(sizeof(float)) <= kIslandStack;
  side_of_body_ = DeviceArray<int32_t>::from_host(sides, device, 2);
  moved_by_ = DeviceArray<int32_t>::from_host(moved_by, device);
  group_of_tree_ = DeviceArray<int32_t>::from_host(group_of_tree, device);
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
  sweeps_ = DeviceArray<int32_t>(groups, device);
  residual_ = DeviceArray<float>(groups, device);
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

void LaunchedContacts::reserve(int64_t contacts) {
  if (contacts <= capacity_) return;
  const Device device = model_.device();
  const auto count = static_cast<size_t>(contacts);
  group_ = DeviceArray<int32_t>(count, device);
  contacts_ = DeviceArray<int32_t>(count, device);
  chain_ = DeviceArray<int32_t>(count, device, kLinkNumbers);
  now_ = DeviceArray<float>(count, device, kKeptNumbers);
  kept_ = DeviceArray<float>(count, device, kKeptNumbers);
  memory_ = DeviceArray<float>(count * static_cast<size_t>(contact_stride_), device);
  kept_begin_ = DeviceArray<int32_t>(static_cast<size_t>(groups_) + 1, device);
  capacity_ = contacts;
}

bool LaunchedContacts::has_friction() {
  if (!friction_stamp_.matches(model_.joint_friction)) {
    const Unobserved unobserved;
    const OnHost<float> friction(model_.joint_friction);
    has_friction_ = std::any_of(friction.data(), friction.data() + friction.size(),
                                [](float x) { return x > 0.0f; });
    friction_stamp_.set(model_.joint_friction);
  }
  return has_friction_;
}

bool LaunchedContacts::has_rows(const Contacts* contacts) {
  const bool friction = has_friction();
  return groups_ > 0 &&
         (friction || capacity_ > 0 || (contacts != nullptr && contacts->rigid_contact_max() > 0));
}

ContactShapes LaunchedContacts::shapes(const ContactArguments& contacts) const {
  return {.at = contacts.at,
          .shape_body = model_.shape_body,
          .side_of_body = Untyped(side_of_body_),
          .group_of_tree = group_of_tree_,
          .shapes = model_.shape_count(),
          .bodies = model_.body_count()};
}

// The contacts of each group, in their order.
void LaunchedContacts::list_contacts(const ContactArguments& contacts,
                                     const ContactRecord& record) const {
  run(contact_kernels().contact_group, contacts.most,
      {.shapes = shapes(contacts),
       .rows = Untyped(articulations_.rows()),
       .count = contacts.count,
       .group = group_,
       .force = contacts.force,
       .impulses = record.impulses});
  run(incidence(), groups_,
      {.table = group_, .slots = contacts.most, .offsets = contact_begin_, .items = contacts_});
}

ContactGroupArguments LaunchedContacts::groups(const ContactArguments& contacts,
                                               const FeatherstoneOptions& o,
                                               const ContactRecord& record,
                                               const DeviceArray<float>& memory,
                                               int64_t stride) const {
  return {.shapes = shapes(contacts),
          .mu = model_.shape_material_mu,
          .restitution = model_.shape_material_restitution,
          .ke = model_.shape_material_ke,
          .kd = model_.shape_material_kd,
          .joint_friction = model_.joint_friction,
          .tree_begin = tree_begin_,
          .trees = trees_,
          .contact_begin = contact_begin_,
          .contacts = contacts_,
          .shape_type = model_.shape_type,
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

void LaunchedContacts::step(const ArticulationStepArguments& step, const Contacts* contacts,
                            const FeatherstoneOptions& o) {
  this->step(step, contact_arguments(contacts == nullptr ? none_ : *contacts), o, {});
}

void LaunchedContacts::step(const ArticulationStepArguments& step, const ContactArguments& contacts,
                            const FeatherstoneOptions& o, const ContactRecord& record) {
  require(
      !has_long_trees_, ErrorKind::NotImplemented,
      "step: contacts, or dry friction of joints, of a model with an articulation of more than ",
      art::kMatrixJoints, " joints in a row: expected the model on the cpu, got it on ",
      model_.device().str());
  reserve(contacts.most);
  const bool forgets = record.notes && reserve_notes();
  const ContactKernels& k = contact_kernels();
  list_contacts(contacts, record);
  const Untyped none(nullptr);
  const auto noted = [&](const Array& array) { return record.notes ? Untyped(array) : none; };
  run(k.contact_step, groups_,
      {.step = step,
       .of = groups(contacts, o, record, memory_, contact_stride_),
       .point_id = contacts.point_id,
       .moved_by = moved_by_,
       .tolerance = o.pgs_tolerance,
       .most_sweeps = o.pgs_iterations,
       .warm_start = o.warm_start,
       .most_alone = record.records ? 0 : art::kMostTreeContacts,
       .kept_begin = kept_begin_,
       .kept = Untyped(kept_),
       .kept_dt = kept_dt_,
       .kept_friction = kept_friction_,
       .now = Untyped(now_),
       .force = contacts.force,
       .sweeps = sweeps_,
       .residual = residual_,
       .impulses = record.impulses,
       .friction_impulses = record.friction,
       .notes = noted(notes_),
       .seen = noted(seen_),
       .seen_before = noted(seen_before_),
       .seen_begin = noted(seen_begin_),
       .by_restitution = record.by_restitution,
       .continues = record.continues && !forgets});
  if (record.notes) note_branches();
  if (o.warm_start)
    run(k.contact_keep, std::max(contacts.most, groups_ + 1),
        {.begin = contact_begin_,
         .now = Untyped(now_),
         .kept_begin = kept_begin_,
         .kept = Untyped(kept_),
         .kept_dt = kept_dt_,
         .dt = step.in.dt,
         .groups = groups_});
}

void LaunchedContacts::note_branches() const {
  const int64_t some = std::min(groups_, kSomeNotes);
  run(contact_kernels().note_some, some,
      {.notes = Untyped(notes_),
       .some = Untyped(some_notes_),
       .seen = Untyped(seen_),
       .begin = contact_begin_,
       .seen_before = Untyped(seen_before_),
       .seen_begin = seen_begin_,
       .groups = groups_});
  run(contact_kernels().note_step, 1,
      {.some = Untyped(some_notes_), .branches = Untyped(branches_), .count = some});
}

int32_t LaunchedContacts::sweeps() const {
  int32_t most = 0;
  for (const int32_t s : sweeps_.to_host()) most = std::max(most, s);
  return most;
}
float LaunchedContacts::residual() const {
  float most = 0.0f;
  for (const float r : residual_.to_host()) most = std::max(most, r);
  return most;
}

}  // namespace novaphy
