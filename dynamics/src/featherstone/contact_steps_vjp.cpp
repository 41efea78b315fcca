// The adjoints and tangents of ContactSteps, and the branch counts that its steps store.
#include <algorithm>
#include <cstring>

#include "contact_launches.h"
#include "contact_steps.h"
#include "novaphy/core/error.h"
#include "tangent_launches.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr size_t kNoteNumbers = sizeof(art::BranchNotes) / sizeof(int32_t),
                 kBranchNumbers = sizeof(ContactBranches) / sizeof(int32_t),
                 kSeenNumbers = sizeof(SeenContact) / sizeof(int32_t),
                 kMaterialNumbers = sizeof(art::MaterialGradient) / sizeof(float);
// Upper bound of the memory for the linear systems of all groups. Any contacts fit if the total is
// below this bound. Otherwise, with several groups, each group still has memory for kLeastContacts.
constexpr int64_t kMostSystems = int64_t{1} << 24;  // numbers of 8 bytes
constexpr int64_t kLeastContacts = 16;
constexpr int64_t kSomeNotes = 128;  // rows in which the notes of groups are summed in parts

}  // namespace

bool ContactSteps::reserve_notes() {
  const UntrackedScope untracked;
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

void ContactSteps::note_branches() const {
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

void ContactSteps::clear_branches() {
  const UntrackedScope untracked;
  if (branches_.rows() == 0) branches_ = DeviceArray<int32_t>(1, model_.device(), kBranchNumbers);
  const ContactBranches none;
  branches_.Array::copy_from_host(&none, sizeof(none));
}

bool ContactSteps::has_seen() const {
  return last_ && seen_begin_.rows() > 0 && seen_begin_.data()[groups_] > 0;
}
ContactBranches ContactSteps::branches() const {
  ContactBranches all;
  if (branches_.rows() == 0) return all;
  const UntrackedScope untracked;
  branches_.copy_to_host(&all, sizeof(all));
  return all;
}

void add_branches(const ContactBranches& of, ContactBranches& to) {
  to.steps += of.steps;
  to.held += of.held;
  to.unconverged += of.unconverged;
  to.breaking += of.breaking;
  to.sticking += of.sticking;
  to.sliding += of.sliding;
  art::lower(to.normal_margin, of.normal_margin);
  art::lower(to.gap_margin, of.gap_margin);
  art::lower(to.cone_margin, of.cone_margin);
  art::lower(to.slip_margin, of.slip_margin);
  note_steps(of.all, to.all);
}

void ContactSteps::copy(const ContactArguments& from, const ContactArguments& to) const {
  run(contact_kernels().contact_copy, std::max<int64_t>(to.most, 1),
      {.count = from.count,
       .from = from.at,
       .to_count = Untyped(to.count),
       .shape0 = Untyped(to.at.shape0),
       .shape1 = Untyped(to.at.shape1),
       .point0 = Untyped(to.at.point0),
       .point1 = Untyped(to.at.point1),
       .normal = Untyped(to.at.normal),
       .margin0 = Untyped(to.at.margin0),
       .margin1 = Untyped(to.at.margin1),
       .most = to.most});
}

void ContactSteps::reserve_adjoint(bool dry, bool materials) {
  const UntrackedScope untracked;
  const Device device = model_.device();
  const int64_t slots = std::max<int64_t>(capacity_, 1);
  const int64_t dofs = std::max(adjoint_dofs_, dry ? group_dofs_ : 0);
  if (slots > adjoint_capacity_ || dofs > adjoint_dofs_) {
    const int64_t fits = (kMostSystems / slots - 3 - 6 * dofs) / 9;
    const int64_t contacts = std::min(slots, std::max(fits, kLeastContacts));
    // The system of c contacts and d dofs has (3 c + d) (3 c + d + 1) numbers.
    system_of_contact_ = 9 * contacts + 6 * dofs + 3;
    system_of_group_ = dofs * (dofs + 1) + 1;
    if (groups_ == 1) {
      system_of_contact_ = 0;
      system_of_group_ = std::min(art::adjoint_numbers(slots, dofs) + 1, kMostSystems);
    }
    if (device.is_cpu()) {  // the CPU uses memory of each thread instead
      system_of_contact_ = 0;
      system_of_group_ = 1;
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

void ContactSteps::vjp(const ArticulationStepVjpArguments& step, const ContactArguments& contacts,
                       const FeatherstoneOptions& o, const ContactRecord& record,
                       const ContactGradientArguments& to) {
  const bool materials = to.of_materials() && contacts.most > 0;
  if (record.found) read_polytopes();
  reserve(contacts.most);
  reserve_adjoint(record.dry, materials);
  const ContactKernels& k = contact_kernels();
  list_contacts(contacts, {});
  if (materials) run(k.clear, contacts.most, {.shape_of = shape_of_});
  const Untyped none(nullptr);
  run(k.vjp, groups_,
      {.step = step,
       .of = groups(contacts, o, record, adjoint_memory_, adjoint_stride_),
       .impulses = record.impulses,
       .friction_impulses = record.friction,
       .joint_friction = to.joint_friction,
       .materials = materials ? Untyped(materials_) : none,
       .shape_of = materials ? Untyped(shape_of_) : none,
       .notes = to.notes,
       .system = Untyped(system_),
       .system_of_contact = system_of_contact_,
       .system_of_group = system_of_group_,
       .status = adjoint_status_});
  if (!materials) return;
  run(incidence(), model_.shape_count(),
      {.table = shape_of_,
       .slots = 2 * contacts.most,
       .offsets = shape_begin_,
       .items = shape_sides_});
  run(k.materials, model_.shape_count(),
      {.begin = shape_begin_,
       .sides = shape_sides_,
       .materials = Untyped(materials_),
       .mu = to.mu,
       .restitution = to.restitution,
       .ke = to.ke,
       .kd = to.kd});
}

void ContactSteps::jvp(const ArticulationJvpArguments& step, const ContactArguments& contacts,
                       const FeatherstoneOptions& o, const ContactRecord& record,
                       const ContactDualArguments& duals) {
  if (record.found) read_polytopes();
  reserve(contacts.most);
  reserve_adjoint(record.dry, false);
  const int64_t stride = dual_contact_bytes(articulations_.max_dofs()) / 4;
  const auto numbers = static_cast<size_t>(std::max<int64_t>(contacts.most, 1) * stride);
  if (tangent_memory_.size() < numbers) {
    const UntrackedScope untracked;
    tangent_memory_ = DeviceArray<float>(numbers, model_.device());
  }
  list_contacts(contacts, {});
  run(tangent_kernels().contact_step, groups_,
      {.step = step,
       .of = groups(contacts, o, record, tangent_memory_, stride),
       .impulses = record.impulses,
       .friction_impulses = record.friction,
       .joint_friction = duals.joint_friction,
       .mu = duals.mu,
       .restitution = duals.restitution,
       .ke = duals.ke,
       .kd = duals.kd,
       .changes = duals.changes,
       .system = Untyped(system_),
       .system_of_contact = system_of_contact_,
       .system_of_group = system_of_group_,
       .status = adjoint_status_});
}

void ContactSteps::check_adjoint(const char* user) const {
  if (adjoint_status_.rows() == 0) return;
  const UntrackedScope untracked;
  for (const int32_t s : adjoint_status_.to_host())
    require(
        s == 0, ErrorKind::Runtime, user,
        ": backward or jvp: an island of contacts needs a system of ", s - 1,
        " numbers, more than there is memory for: its derivatives are NaN; fewer worlds or more "
        "rigid_contact_max give it more");
}

}  // namespace novaphy
