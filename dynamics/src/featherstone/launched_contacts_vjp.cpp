// The adjoints and tangents of LaunchedContacts, and what their steps note for them.
#include <algorithm>
#include <cstring>

#include "contact_launches.h"
#include "launched_contacts.h"
#include "novaphy/core/error.h"
#include "tangent_launches.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr size_t kNoteNumbers = sizeof(art::BranchNotes) / sizeof(int32_t),
                 kBranchNumbers = sizeof(ContactBranches) / sizeof(int32_t),
                 kSeenNumbers = sizeof(SeenContact) / sizeof(int32_t),
                 kMaterialNumbers = sizeof(art::MaterialGradient) / sizeof(float);
// Of the systems of all groups: as much as any contacts need where it is less than kMostSystems,
// else that; but of several groups so much that those with kLeastContacts have room.
constexpr int64_t kMostSystems = int64_t{1} << 24;  // numbers of 8 bytes
constexpr int64_t kLeastContacts = 16;

}  // namespace

bool LaunchedContacts::reserve_notes() {
  const Unobserved unobserved;
  const Device device = model_.device();
  const auto groups = static_cast<size_t>(groups_);
  const auto contacts = static_cast<size_t>(std::max<int64_t>(capacity_, 1));
  const bool grows = seen_.rows() < contacts;
  if (grows) {
    seen_ = DeviceArray<int32_t>(contacts, device, kSeenNumbers);
    seen_before_ = DeviceArray<int32_t>(contacts, device, kSeenNumbers);
    seen_begin_ = DeviceArray<int32_t>(groups + 1, device);
  }
  if (notes_.rows() == groups) return grows;
  notes_ = DeviceArray<int32_t>(groups, device, kNoteNumbers);
  some_notes_ = DeviceArray<int32_t>(groups, device, kNoteNumbers);
  clear_branches();
  return grows;
}

void LaunchedContacts::clear_branches() {
  const Unobserved unobserved;
  const ContactBranches none;
  std::vector<int32_t> words(kBranchNumbers);
  std::memcpy(words.data(), &none, sizeof(none));
  if (branches_.rows() == 0)
    branches_ = DeviceArray<int32_t>::from_host(words, model_.device(), kBranchNumbers);
  else
    branches_.copy_from_host(std::span<const int32_t>(words));
}
ContactBranches LaunchedContacts::branches() const {
  ContactBranches all;
  if (branches_.rows() == 0) return all;
  const Unobserved unobserved;
  const std::vector<int32_t> words = branches_.to_host();
  std::memcpy(static_cast<void*>(&all), words.data(), sizeof(all));
  return all;
}

void LaunchedContacts::copy(const ContactRowArguments& from, const ContactRowArguments& to) const {
  contact_kernels().copy.launch(
      model_.device(), std::max<int64_t>(to.most, 1),
      {from.count, from.shape0, from.shape1, from.point0, from.point1, from.normal, from.margin0,
       from.margin1, to.count, to.shape0, to.shape1, to.point0, to.point1, to.normal, to.margin0,
       to.margin1, number(to.most)});
}

void LaunchedContacts::reserve_adjoint(bool dry, bool materials) {
  const Unobserved unobserved;
  const Device device = model_.device();
  const int64_t slots = std::max<int64_t>(capacity_, 1);
  const int64_t dofs = std::max(adjoint_dofs_, dry ? group_dofs_ : 0);
  if (slots > adjoint_capacity_ || dofs > adjoint_dofs_) {
    const int64_t fits = (kMostSystems / slots - 3 - 6 * dofs) / 9;
    const int64_t contacts = std::min(slots, std::max(fits, kLeastContacts));
    // (3 c + d) (3 c + d + 1) for c contacts and d dofs.
    system_of_contact_ = 9 * contacts + 6 * dofs + 3;
    system_of_group_ = dofs * (dofs + 1) + 1;
    if (groups_ == 1) {
      system_of_contact_ = 0;
      system_of_group_ = std::min(art::adjoint_numbers(slots, dofs) + 1, kMostSystems);
    }
    system_ = DeviceArray<float>(
        static_cast<size_t>(2 * (slots * system_of_contact_ + groups_ * system_of_group_)), device);
    adjoint_memory_ = DeviceArray<float>(static_cast<size_t>(slots * adjoint_stride_), device);
    adjoint_status_ = DeviceArray<int32_t>(static_cast<size_t>(groups_), device);
    adjoint_capacity_ = slots;
    adjoint_dofs_ = dofs;
  }
  const auto count = static_cast<size_t>(slots);
  if (!materials || materials_.rows() >= count) return;
  materials_ = DeviceArray<float>(count, device, kMaterialNumbers);
  shape_of_ = DeviceArray<int32_t>(2 * count, device);
  shape_sides_ = DeviceArray<int32_t>(2 * count, device);
  shape_begin_ = DeviceArray<int32_t>(static_cast<size_t>(model_.shape_count()) + 1, device);
}

void LaunchedContacts::vjp(std::vector<LaunchArgument> words, const ContactRowArguments& rows,
                           const FeatherstoneOptions& o, const ContactRecord& record,
                           const ContactGradientArguments& to) {
  const Device device = model_.device();
  const bool materials = to.of_materials() && rows.most > 0;
  reserve(rows.most);
  reserve_adjoint(record.dry, materials);
  const ContactKernels& k = contact_kernels();
  ContactRecord lists;  // without results
  list_rows(rows, lists);
  if (materials) k.clear.launch(device, rows.most, {writes("shape_of", shape_of_)});
  add_words(words, group_words(rows, o, record, adjoint_memory_, adjoint_stride_));
  const LaunchArgument none;
  add_words(words, {record.impulses, record.friction, to.joint_friction,
                    materials ? writes("materials", materials_) : none,
                    materials ? writes("shape_of", shape_of_) : none, writes("system", system_),
                    number(system_of_contact_), number(system_of_group_),
                    writes_row("status", adjoint_status_)});
  k.vjp.launch(device, groups_, words);
  if (!materials) return;
  k.lists.launch(device, model_.shape_count(),
                 {reads("shape_of", shape_of_), number(2 * rows.most),
                  writes("shape_begin", shape_begin_), writes("shape_sides", shape_sides_)});
  k.materials.launch(
      device, model_.shape_count(),
      {reads("shape_begin", shape_begin_), reads("shape_sides", shape_sides_),
       reads("materials", materials_).detached(), to.mu, to.restitution, to.ke, to.kd});
}

void LaunchedContacts::jvp(std::vector<LaunchArgument> words, const ContactRowArguments& rows,
                           const FeatherstoneOptions& o, const ContactRecord& record,
                           const ContactGradientArguments& duals) {
  const Device device = model_.device();
  reserve(rows.most);
  reserve_adjoint(record.dry, false);
  const int64_t stride = dual_contact_bytes(articulations_.max_dofs()) / 4;
  const auto numbers = static_cast<size_t>(std::max<int64_t>(rows.most, 1) * stride);
  if (tangent_memory_.size() < numbers) {
    const Unobserved unobserved;
    tangent_memory_ = DeviceArray<float>(numbers, device);
  }
  list_rows(rows, {});  // without results
  add_words(words, group_words(rows, o, record, tangent_memory_, stride));
  add_words(words,
            {record.impulses, record.friction, duals.joint_friction, duals.mu, duals.restitution,
             duals.ke, duals.kd, writes("system", system_), number(system_of_contact_),
             number(system_of_group_), writes_row("status", adjoint_status_)});
  tangent_kernels().contact_step.launch(device, groups_, words);
}

void LaunchedContacts::check_adjoint(const char* user) const {
  if (adjoint_status_.rows() == 0) return;
  const Unobserved unobserved;
  for (const int32_t s : adjoint_status_.to_host())
    require(
        s == 0, ErrorKind::Runtime, user,
        ": backward or jvp: an island of contacts needs a system of ", s - 1,
        " numbers, more than there is memory for: its derivatives are NaN; fewer worlds or more "
        "rigid_contact_max give it more");
}

}  // namespace novaphy
