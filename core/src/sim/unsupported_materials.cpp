#include "novaphy/core/sim/unsupported_materials.h"

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/shape_config.h"

namespace novaphy {
namespace {

std::string shape_name(const Model& model, size_t shape) {
  const std::string number = std::to_string(shape);
  if (shape >= model.shape_label.size() || model.shape_label[shape].empty()) return number;
  return number + " (" + model.shape_label[shape] + ")";
}

}  // namespace

void UnsupportedMaterials::check(const Model& model) {
  struct Setting {
    const char* name;
    const DeviceArray<float>& array;
    float by_default;
    bool is_read;
    bool may_be_zero = true;  // 0 switches the force off
  };
  const ShapeConfig d;
  const Setting settings[] = {
      {"kf", model.shape_material_kf, d.kf, reads_.kf, false},
      {"ka", model.shape_material_ka, d.ka, reads_.ka},
      {"restitution", model.shape_material_restitution, d.restitution, reads_.restitution},
      {"mu_torsional", model.shape_material_mu_torsional, d.mu_torsional, false},
      {"mu_rolling", model.shape_material_mu_rolling, d.mu_rolling, false}};
  for (size_t k = 0; k < known_.size(); ++k) {
    const Setting& setting = settings[k];
    if (setting.is_read || setting.array.rows() == 0 || known_[k].matches(setting.array)) continue;
    const UntrackedScope untracked;
    const std::vector<float> values = setting.array.to_host();
    for (size_t s = 0; s < values.size(); ++s)
      require(values[s] == setting.by_default || (setting.may_be_zero && values[s] == 0.0f),
              ErrorKind::NotImplemented, solver_, ": shape ", shape_name(model, s),
              ": ShapeConfig.", setting.name, " (model.shape_material_", setting.name,
              "): expected the default ", setting.by_default,
              ", because this solver does not read it, got ", values[s]);
    known_[k].set(setting.array);
  }
  if (!reads_.ropes) check_ropes(model);
}

void UnsupportedMaterials::check_ropes(const Model& model) {
  const DeviceArray<uint8_t>& ropes = model.particle_spring_tension_only;
  if (ropes.rows() == 0 || ropes_.matches(ropes)) return;
  const UntrackedScope untracked;
  const std::vector<uint8_t> values = ropes.to_host();
  for (size_t e = 0; e < values.size(); ++e)
    require(values[e] == 0, ErrorKind::NotImplemented, solver_,
            ": model.particle_spring_tension_only[", e,
            "]: expected 0, because ropes are not supported, got ", int{values[e]},
            "; use SolverVBD");
  ropes_.set(ropes);
}

}  // namespace novaphy
