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

// What a tape makes of the results, those who record them say.
LaunchArgument value(const char* name, const Array& array) { return reads(name, array).detached(); }

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

ContactRowArguments::ContactRowArguments(const Contacts& c)
    : count(reads("rigid_contact_count", c.rigid_contact_count)),
      shape0(reads("rigid_contact_shape0", c.rigid_contact_shape0)),
      shape1(reads("rigid_contact_shape1", c.rigid_contact_shape1)),
      point_id(reads("rigid_contact_point_id", c.rigid_contact_point_id)),
      point0(value("rigid_contact_point0", c.rigid_contact_point0)),
      point1(value("rigid_contact_point1", c.rigid_contact_point1)),
      normal(value("rigid_contact_normal", c.rigid_contact_normal)),
      margin0(value("rigid_contact_margin0", c.rigid_contact_margin0)),
      margin1(value("rigid_contact_margin1", c.rigid_contact_margin1)),
      force(writes("rigid_contact_force", c.rigid_contact_force)),
      most(c.rigid_contact_max()) {}

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

// The words of ContactShapes.
std::vector<LaunchArgument> LaunchedContacts::shapes(const ContactRowArguments& rows) const {
  return {rows.shape0,
          rows.shape1,
          reads("model.shape_body", model_.shape_body),
          reads("side_of_body", side_of_body_),
          reads("group_of_tree", group_of_tree_),
          number(int64_t{model_.shape_count()}),
          number(int64_t{model_.body_count()})};
}

// The contacts of each group, in their order.
void LaunchedContacts::list_rows(const ContactRowArguments& rows,
                                 const ContactRecord& record) const {
  std::vector<LaunchArgument> group = shapes(rows);
  add_words(group, {reads("rows", articulations_.rows()), rows.count, writes_row("group", group_),
                    rows.force, record.impulses});
  contact_kernels().group.launch(model_.device(), rows.most, group);
  contact_kernels().lists.launch(
      model_.device(), groups_,
      {reads("group", group_), number(rows.most), writes("contact_begin", contact_begin_),
       writes("contacts", contacts_)});
}

// The words of ContactGroupArguments.
std::vector<LaunchArgument> LaunchedContacts::group_words(const ContactRowArguments& rows,
                                                          const FeatherstoneOptions& o,
                                                          const ContactRecord& record,
                                                          const DeviceArray<float>& memory,
                                                          int64_t stride) const {
  std::vector<LaunchArgument> words = shapes(rows);
  add_words(words, {rows.point0,
                    rows.point1,
                    rows.normal,
                    rows.margin0,
                    rows.margin1,
                    value("model.shape_material_mu", model_.shape_material_mu),
                    value("model.shape_material_restitution", model_.shape_material_restitution),
                    value("model.shape_material_ke", model_.shape_material_ke),
                    value("model.shape_material_kd", model_.shape_material_kd),
                    value("model.joint_friction", model_.joint_friction),
                    reads("tree_begin", tree_begin_),
                    reads("trees", trees_),
                    reads("contact_begin", contact_begin_),
                    reads("contacts", contacts_),
                    number(o.pgs_erp),
                    number(o.pgs_slop),
                    number(o.pgs_cfm),
                    number(o.max_depenetration_velocity),
                    number(o.restitution_threshold),
                    number(int64_t{o.compliant_contacts}),
                    number(int64_t{o.friction_cone == FrictionCone::Cone}),
                    reads("model.shape_type", model_.shape_type),
                    number(int64_t{record.found}),
                    writes("chain", chain_),
                    writes("nodes", nodes_),
                    writes("memory", memory),
                    number(stride)});
  return words;
}

void LaunchedContacts::step(std::vector<LaunchArgument> words, const Contacts* contacts,
                            const FeatherstoneOptions& o, float dt) {
  step(std::move(words), ContactRowArguments(contacts == nullptr ? none_ : *contacts), o, dt, {});
}

void LaunchedContacts::step(std::vector<LaunchArgument> words, const ContactRowArguments& rows,
                            const FeatherstoneOptions& o, float dt, const ContactRecord& record) {
  const Device device = model_.device();
  require(
      !has_long_trees_, ErrorKind::NotImplemented,
      "step: contacts, or dry friction of joints, of a model with an articulation of more than ",
      art::kMatrixJoints, " joints in a row: expected the model on the cpu, got it on ",
      device.str());
  reserve(rows.most);
  const bool forgets = record.notes && reserve_notes();
  const ContactKernels& k = contact_kernels();
  list_rows(rows, record);
  add_words(words, group_words(rows, o, record, memory_, contact_stride_));
  const LaunchArgument none;
  add_words(words, {rows.point_id,
                    reads("moved_by", moved_by_),
                    number(o.pgs_tolerance),
                    number(int64_t{o.pgs_iterations}),
                    number(int64_t{o.warm_start}),
                    number(int64_t{record.records ? 0 : art::kMostTreeContacts}),
                    reads("kept_begin", kept_begin_),
                    reads("kept", kept_),
                    reads("kept_dt", kept_dt_),
                    updates("kept_friction", kept_friction_),
                    writes("now", now_),
                    rows.force,
                    writes_row("sweeps", sweeps_),
                    writes_row("residual", residual_),
                    record.impulses,
                    record.friction,
                    record.notes ? writes_row("notes", notes_) : none,
                    record.notes ? writes("seen", seen_) : none,
                    record.notes ? reads("seen_before", seen_before_) : none,
                    record.notes ? reads("seen_begin", seen_begin_) : none,
                    number(int64_t{record.by_restitution}),
                    number(int64_t{record.continues && !forgets})});
  k.step.launch(device, groups_, words);
  if (record.notes) {
    const int64_t some = std::min(groups_, kSomeNotes);
    k.note_some.launch(
        device, some,
        {reads("notes", notes_), writes_row("some_notes", some_notes_), reads("seen", seen_),
         reads("contact_begin", contact_begin_), updates("seen_before", seen_before_),
         writes("seen_begin", seen_begin_), number(groups_)});
    k.note_step.launch(
        device, 1,
        {reads("some_notes", some_notes_), updates("branches", branches_), number(some)});
  }
  if (o.warm_start)
    k.keep.launch(device, std::max(rows.most, groups_ + 1),
                  {reads("contact_begin", contact_begin_), reads("now", now_),
                   writes("kept_begin", kept_begin_), updates("kept", kept_),
                   writes("kept_dt", kept_dt_), number(dt), number(groups_)});
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
