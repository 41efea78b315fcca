#include "device_soft_contacts.h"

#include <bit>
#include <map>
#include <mutex>
#include <vector>

#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"

namespace novaphy::detail {
namespace {

// The compiled module, once per device; never destroyed, like the backend that it belongs to.
struct Kernels {
  novaphy_kernel *touch = nullptr, *write = nullptr, *clear = nullptr, *scan = nullptr;
};

void load(const DeviceContext& context, int32_t format, const std::string& code,
          const char* const* names, novaphy_kernel** kernels) {
  novaphy_error error = make_error();
  novaphy_module* module = nullptr;
  check(
      context.api->module_create(context.device, format, code.data(), code.size(), &module, &error),
      error, "collide");
  for (; *names != nullptr; ++names, ++kernels)
    check(context.api->kernel_get(module, *names, kernels, &error), error, "collide");
}

const Kernels& kernels_of(const DeviceContext& context) {
  static std::mutex mutex;
  static auto& all = *new std::map<const DeviceContext*, Kernels>;
  const std::lock_guard lock(mutex);
  const auto found = all.find(&context);
  if (found != all.end()) return found->second;
  static constexpr const char* kNames[] = {"soft_contact_touch", "soft_contact_write",
                                           "soft_contact_clear", nullptr};
  static constexpr const char* kMain[] = {"main", nullptr};
  novaphy_kernel* made[4] = {};
  load(context, NOVAPHY_CODE_SOURCE, soft_contacts_module(), kNames, made);
  load(context, NOVAPHY_CODE_BUILTIN, "exclusive_scan_i32", kMain, made + 3);
  return all[&context] = {made[0], made[1], made[2], made[3]};
}

uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }

void launch(const DeviceContext& context, novaphy_kernel* kernel, int64_t n,
            const std::vector<uint64_t>& words) {
  novaphy_error error = make_error();
  check(context.api->launch(context.stream, kernel, n, words.data(),
                            static_cast<uint32_t>(words.size()), &error),
        error, "collide");
}

}  // namespace

std::string soft_contacts_module() {
  const auto constant = [](const char* name, int32_t value) {
    return std::string("#define ") + name + " " + std::to_string(value) + "\n";
  };
  return constant("NOVAPHY_GEO_BOX", static_cast<int32_t>(GeoType::BOX)) +
         constant("NOVAPHY_GEO_SPHERE", static_cast<int32_t>(GeoType::SPHERE)) +
         constant("NOVAPHY_GEO_CAPSULE", static_cast<int32_t>(GeoType::CAPSULE)) +
         constant("NOVAPHY_PARTICLE_ACTIVE", static_cast<int32_t>(ParticleFlags::ACTIVE)) +
         soft_contacts_text();
}

struct DeviceSoftContacts::Impl {
  std::shared_ptr<const Model> model;
  // Which shapes may be met, and the versions of the arrays that say so.
  bool known = false;
  uint64_t flags_version = 0, body_version = 0, type_version = 0;
  DeviceArray<int32_t> candidates;
  DeviceArray<int32_t> before;  // the slots before each pair, kept from call to call

  void find_candidates() {
    const Model& m = *model;
    if (known && flags_version == m.shape_flags.version() &&
        body_version == m.shape_body.version() && type_version == m.shape_type.version() &&
        !m.shape_flags.range()->writable_export())
      return;
    const std::vector<int32_t> flags = m.shape_flags.to_host(), body = m.shape_body.to_host(),
                               type = m.shape_type.to_host();
    std::vector<int32_t> shapes;
    for (int32_t s = 0; s < m.shape_count(); ++s) {
      const auto at = static_cast<size_t>(s);
      if (!has_flag(flags[at], ShapeFlags::COLLIDE_PARTICLES)) continue;
      check_covered_shape(s, body[at], static_cast<GeoType>(type[at]));
      shapes.push_back(s);
    }
    candidates = DeviceArray<int32_t>::from_host(shapes, m.device());
    flags_version = m.shape_flags.version();
    body_version = m.shape_body.version();
    type_version = m.shape_type.version();
    known = true;
  }
};

DeviceSoftContacts::DeviceSoftContacts(std::shared_ptr<const Model> model)
    : impl_(std::make_unique<Impl>()) {
  impl_->model = std::move(model);
}
DeviceSoftContacts::~DeviceSoftContacts() = default;

int32_t DeviceSoftContacts::candidate_count() {
  impl_->find_candidates();
  return static_cast<int32_t>(impl_->candidates.rows());
}

void DeviceSoftContacts::collide(const SimState& state, Contacts& contacts, float gap) {
  const Model& m = *impl_->model;
  const DeviceContext& context = device_context(m.device());
  const Kernels& kernels = kernels_of(context);
  impl_->find_candidates();
  const int64_t pairs = contacts.soft_contact_pair_count(), slots = contacts.soft_contact_max();
  const std::vector<uint64_t> records = {word(contacts.soft_contact_particle.mutable_data()),
                                         word(contacts.soft_contact_shape.mutable_data()),
                                         word(contacts.soft_contact_body_pos.mutable_data()),
                                         word(contacts.soft_contact_body_vel.mutable_data()),
                                         word(contacts.soft_contact_normal.mutable_data()),
                                         word(contacts.soft_contact_count.mutable_data())};
  const uint64_t tids = word(contacts.soft_contact_tids.mutable_data());
  if (pairs == 0) {
    contacts.soft_contact_count.zero();
  } else {
    if (impl_->before.rows() < static_cast<size_t>(pairs))
      impl_->before = DeviceArray<int32_t>(static_cast<size_t>(pairs), m.device());
    const uint64_t before = word(impl_->before.mutable_data());
    std::vector<uint64_t> words = {word(impl_->candidates.data()),
                                   static_cast<uint64_t>(m.particle_count()),
                                   std::bit_cast<uint32_t>(gap),
                                   word(state.particle_q.data()),
                                   word(m.particle_radius.data()),
                                   word(m.particle_flags.data()),
                                   word(m.particle_world.data()),
                                   word(m.shape_type.data()),
                                   word(m.shape_world.data()),
                                   word(m.shape_scale.data()),
                                   word(m.shape_transform.data()),
                                   word(m.shape_margin.data()),
                                   tids};
    launch(context, kernels.touch, pairs, words);
    launch(context, kernels.scan, pairs, {tids, before});
    words.push_back(before);
    words.insert(words.end(), records.begin(), records.end());
    words.push_back(static_cast<uint64_t>(slots));
    launch(context, kernels.write, pairs, words);
  }
  std::vector<uint64_t> words = records;
  words.push_back(word(contacts.contact_generation.mutable_data()));
  launch(context, kernels.clear, slots + 1, words);
}

}  // namespace novaphy::detail
