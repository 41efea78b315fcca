#include "novaphy/core/sim/contacts.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/contact_count.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/on_host.h"

namespace novaphy {
namespace {

ContactCounts checked_counts(const ContactsOptions& options) {
  require(options.soft_contact_max >= 0, ErrorKind::Value,
          "Contacts: soft_contact_max: expected >= 0, got ", options.soft_contact_max);
  require(options.soft_contact_pair_count >= 0, ErrorKind::Value,
          "Contacts: soft_contact_pair_count: expected >= 0, got ",
          options.soft_contact_pair_count);
  require(options.rigid_contact_max >= 0, ErrorKind::Value,
          "Contacts: rigid_contact_max: expected >= 0, got ", options.rigid_contact_max);
  return {.soft_contact_max = options.soft_contact_max,
          .soft_contact_pair_count = options.soft_contact_pair_count,
          .rigid_contact_max = options.rigid_contact_max,
          .rigid_contact_materials =
              options.per_contact_shape_properties ? options.rigid_contact_max : 0};
}

// Returns the arrays from which the rows of rigid contacts were computed.
std::array<const Array*, 5> sources(const Model& model, const Array& body_q) {
  return {&body_q, &model.shape_body, &model.shape_type, &model.shape_transform,
          &model.shape_scale};
}

template <size_t N>
void set_stamps(std::array<ArrayStamp, N>& stamps, const std::array<const Array*, N>& arrays) {
  for (size_t k = 0; k < N; ++k) stamps[k].set(*arrays[k]);
}
template <size_t N>
bool all_match(const std::array<ArrayStamp, N>& stamps, const std::array<const Array*, N>& arrays) {
  for (size_t k = 0; k < N; ++k)
    if (!stamps[k].matches(*arrays[k])) return false;
  return true;
}

}  // namespace

Contacts::Contacts(const ContactsOptions& options, Device device)
    : requires_grad(options.requires_grad),
      counts_(checked_counts(options)),
      device_(device),
      model_id_(options.model_id) {
  allocate(counts_, device_);
  soft_contact_particle.fill(-1);
  soft_contact_shape.fill(-1);
  soft_contact_tids.fill(-1);
  rigid_contact_shape0.fill(-1);
  rigid_contact_shape1.fill(-1);
  rigid_contact_point_id.fill(-1);
}

Contacts::Contacts(const Contacts& source, ContactFields fields)
    : ContactFields(std::move(fields)),
      requires_grad(source.requires_grad),
      counts_(source.counts_),
      device_(source.device_),
      model_id_(source.model_id_) {
  if (!source.rows_are_as_found()) return;
  found_from_ = source.found_from_;
  set_stamps(as_found_, row_arrays());
}

void Contacts::clear() {
  soft_contact_count.zero();
  soft_contact_particle.fill(-1);
  soft_contact_shape.fill(-1);
  soft_contact_body_pos.zero();
  soft_contact_body_vel.zero();
  soft_contact_normal.zero();
  soft_contact_tids.fill(-1);
  rigid_contact_count.zero();
  rigid_contact_shape0.fill(-1);
  rigid_contact_shape1.fill(-1);
  for (DeviceArray<Vec3f>* array :
       {&rigid_contact_point0, &rigid_contact_point1, &rigid_contact_offset0,
        &rigid_contact_offset1, &rigid_contact_normal, &rigid_contact_force})
    array->zero();
  rigid_contact_margin0.zero();
  rigid_contact_margin1.zero();
  clear_materials();
  rigid_contact_point_id.fill(-1);
  contact_generation.fill(contact_generation.to_host()[0] + 1);
}

void Contacts::clear_materials() {
  rigid_contact_stiffness.zero();
  rigid_contact_damping.zero();
  rigid_contact_friction.zero();
}

void Contacts::check_materials(const char* function) const {
  if (!device_.is_cpu()) return;
  const UntrackedScope untracked;
  const auto check = [&](const char* name, const DeviceArray<float>& array) {
    const float* const values = array.data();
    for (size_t row = 0; row < array.rows(); ++row)
      require(std::isfinite(values[row]) && values[row] >= 0.0f, ErrorKind::Value, function,
              ": contacts.", name, "[", row, "]: expected a finite number >= 0, got ", values[row]);
  };
  check("rigid_contact_stiffness", rigid_contact_stiffness);
  check("rigid_contact_damping", rigid_contact_damping);
  check("rigid_contact_friction", rigid_contact_friction);
}

int32_t Contacts::active_soft_contact_count() const {
  return std::clamp(soft_contact_count.to_host()[0], 0, counts_.soft_contact_max);
}

int32_t Contacts::active_rigid_contact_count() const {
  const int32_t count = OnHost<int32_t>(rigid_contact_count)[0], most = counts_.rigid_contact_max;
  if (count <= most) return std::max(count, 0);
  return filled_rows(count, most, OnHost<int32_t>(rigid_contact_shape0).data());
}

bool Contacts::overflowed() const {
  return soft_contact_count.to_host()[0] > counts_.soft_contact_max ||
         rigid_contact_count.to_host()[0] > counts_.rigid_contact_max;
}

std::vector<SoftContact> Contacts::soft_contacts() const {
  const auto particle = soft_contact_particle.to_host();
  const auto shape = soft_contact_shape.to_host();
  const auto body_pos = soft_contact_body_pos.to_host();
  const auto body_vel = soft_contact_body_vel.to_host();
  const auto normal = soft_contact_normal.to_host();
  std::vector<SoftContact> contacts(static_cast<size_t>(active_soft_contact_count()));
  for (size_t i = 0; i < contacts.size(); ++i)
    contacts[i] = {particle[i], shape[i], body_pos[i], body_vel[i], normal[i]};
  return contacts;
}

std::vector<RigidContact> Contacts::rigid_contacts() const {
  const auto shape0 = rigid_contact_shape0.to_host(), shape1 = rigid_contact_shape1.to_host();
  const auto point0 = rigid_contact_point0.to_host(), point1 = rigid_contact_point1.to_host();
  const auto offset0 = rigid_contact_offset0.to_host(), offset1 = rigid_contact_offset1.to_host();
  const auto normal = rigid_contact_normal.to_host(), force = rigid_contact_force.to_host();
  const auto margin0 = rigid_contact_margin0.to_host(), margin1 = rigid_contact_margin1.to_host();
  const auto point_id = rigid_contact_point_id.to_host();
  std::vector<RigidContact> contacts(static_cast<size_t>(active_rigid_contact_count()));
  for (size_t i = 0; i < contacts.size(); ++i)
    contacts[i] = {shape0[i], shape1[i],  point0[i],  point1[i],   offset0[i], offset1[i],
                   normal[i], margin0[i], margin1[i], point_id[i], force[i]};
  return contacts;
}

void Contacts::assign(const Contacts& source) {
  detail::assign_fields(detail::mutable_fields<ContactFields>(*this),
                        detail::const_fields<ContactFields>(source), "Contacts.assign");
}

Contacts Contacts::clone() const {
  return Contacts(*this, detail::copy_fields<ContactFields>(*this, device_));
}

std::array<const Array*, Contacts::kRowArrays> Contacts::row_arrays() const {
  return {&rigid_contact_count,   &rigid_contact_shape0, &rigid_contact_shape1,
          &rigid_contact_point0,  &rigid_contact_point1, &rigid_contact_normal,
          &rigid_contact_margin0, &rigid_contact_margin1};
}

void Contacts::set_rigid_contacts_found_from(const Model& model, const Array& body_q) {
  set_stamps(found_from_, sources(model, body_q));
  set_stamps(as_found_, row_arrays());
}

bool Contacts::rows_are_as_found() const { return all_match(as_found_, row_arrays()); }

bool Contacts::rigid_contacts_found_from(const Model& model, const Array& body_q) const {
  return all_match(found_from_, sources(model, body_q)) && rows_are_as_found();
}

}  // namespace novaphy
