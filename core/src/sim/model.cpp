#include "novaphy/core/sim/model.h"

#include <atomic>
#include <cmath>
#include <random>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"

namespace novaphy {
namespace {

// Ids count from a random start, so that models of different processes have different ids.
uint64_t next_model_id() {
  static std::atomic<uint64_t> next{[] {
    std::random_device device;
    return uint64_t{device()} << 32 | device();
  }()};
  return next.fetch_add(1, std::memory_order_relaxed);
}

}  // namespace

Model::Model(const ModelCounts& counts, Device device, Axis up_axis)
    : counts_(counts), device_(device), up_axis_(up_axis), id_(next_model_id()) {}

SimState Model::state(std::optional<bool> grad) const {
  SimState state(*this);
  state.requires_grad = grad.value_or(requires_grad);
  state.particle_q.assign(particle_q);
  state.particle_qd.assign(particle_qd);
  state.body_q.assign(body_q);
  state.body_qd.assign(body_qd);
  state.joint_q.assign(joint_q);
  state.joint_qd.assign(joint_qd);
  state.act.assign(act);
  return state;
}

Control Model::control(std::optional<bool> grad) const {
  Control control(*this);
  control.requires_grad = grad.value_or(requires_grad);
  control.joint_f.assign(joint_f);
  control.joint_target_q.assign(joint_target_q);
  control.joint_target_qd.assign(joint_target_qd);
  control.joint_act.assign(joint_act);
  control.particle_tri_activation.assign(particle_tri_activation);
  control.particle_tet_activation.assign(particle_tet_activation);
  control.ctrl.assign(ctrl);
  return control;
}

int32_t Model::shape_contact_pair_count() const {
  return static_cast<int32_t>(shape_contact_pairs().rows());
}

std::vector<std::vector<int32_t>> Model::particle_color_groups() const {
  std::vector<std::vector<int32_t>> groups;
  const std::vector<int32_t> colors = particle_colors.to_host();
  for (size_t p = 0; p < colors.size(); ++p) {
    if (colors[p] < 0) continue;
    const auto color = static_cast<size_t>(colors[p]);
    if (color >= groups.size()) groups.resize(color + 1);
    groups[color].push_back(static_cast<int32_t>(p));
  }
  return groups;
}

void Model::set_gravity(const Vec3f& value, std::optional<int32_t> world) {
  require(std::isfinite(value.x) && std::isfinite(value.y) && std::isfinite(value.z),
          ErrorKind::Value, "set_gravity: value: expected finite numbers, got (", value.x, ", ",
          value.y, ", ", value.z, ")");
  if (!world) {
    gravity.fill(value);
    return;
  }
  require(*world >= 0 && *world < world_count(), ErrorKind::Index,
          "set_gravity: world: expected 0 to ", world_count() - 1, ", got ", *world);
  std::vector<Vec3f> values = gravity.to_host();
  values[static_cast<size_t>(*world)] = value;
  gravity.copy_from_host(std::span<const Vec3f>(values));
}

std::shared_ptr<Model> Model::restore(const ModelCounts& counts, Device device, Axis up_axis,
                                      uint64_t id) {
  std::shared_ptr<Model> model(new Model(counts, device, up_axis));
  model->allocate(counts, device);
  model->id_ = id;
  return model;
}

void Model::accept_derived() const {
#define NOVAPHY_ACCEPT_DERIVED(derived, source, rule) derived_stamps_.derived.set(source);
  NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_ACCEPT_DERIVED)
#undef NOVAPHY_ACCEPT_DERIVED
}

void Model::update_derived() const {
  update_derived([](const auto& rule, const Array& source, Array derived) {
    const size_t from = rule.source_width, to = rule.derived_width;
    std::vector<float> in(source.rows() * from), out(derived.rows() * to);
    source.copy_to_host(in.data(), in.size() * sizeof(float));
    for (size_t row = 0; row < source.rows(); ++row) rule(&in[row * from], &out[row * to]);
    derived.copy_from_host(out.data(), out.size() * sizeof(float));
    return true;
  });
}

void check_number(std::string_view function, std::string_view object, const NumberInfo& info,
                  float value) {
  const bool good = value >= 0.0f && (info.may_be_infinite || std::isfinite(value));
  require(good, ErrorKind::Value, function, object, info.name, ": expected a ",
          info.may_be_infinite ? "" : "finite ", "number >= 0, got ", value);
}

void Model::check_numbers(std::string_view function) const {
  visit_numbers([&](const NumberInfo& info, const float& value) {
    check_number(function, ": model.", info, value);
  });
}

void Model::depend_on_numbers() const {
  LaunchRecorder* const recorder = launch_recorder();
  if (recorder == nullptr) return;
  const std::shared_ptr<const Model> owner = shared_from_this();
  visit_numbers([&](const NumberInfo& info, const float& number) {
    recorder->depends_on(std::shared_ptr<const float>(owner, &number), info.name);
  });
}

std::shared_ptr<Model> Model::to(Device device) const {
  std::shared_ptr<Model> copy(new Model(counts_, device, up_axis_));
  static_cast<ModelFields&>(*copy) = detail::copy_fields<ModelFields>(*this, device);
  static_cast<ModelSettings&>(*copy) = *this;
#define NOVAPHY_COPY_STAMP(derived, source, rule) \
  if (derived_stamps_.derived.matches(source)) copy->derived_stamps_.derived.set(copy->source);
  NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_COPY_STAMP)
#undef NOVAPHY_COPY_STAMP
  copy->shape_pair_list_.follow(shape_pair_list_.columns());
  if (shape_pair_list_.is_made())
    copy->shape_pair_list_.set(DeviceArray<Vec2i>(shape_contact_pairs().to(device)));
  copy->structure_ = structure_;
  return copy;
}

std::shared_ptr<const Model> Model::on_host() const {
  if (device().is_cpu()) return {std::shared_ptr<const Model>(), this};
  const UntrackedScope untracked;
  return to(Device::cpu());
}

}  // namespace novaphy
