#include "novaphy/core/sim/edited_values.h"

#include <cmath>
#include <span>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"

namespace novaphy {
namespace {

// Of an array: on the host without a copy where it lies there.
template <class T>
class OnHost {
 public:
  explicit OnHost(const DeviceArray<T>& array) {
    if (array.device().is_cpu()) {
      values_ = {array.data(), array.rows()};
    } else {
      copy_ = array.to_host();
      values_ = copy_;
    }
  }
  const T& operator[](size_t k) const { return values_[k]; }
  size_t size() const { return values_.size(); }

 private:
  std::vector<T> copy_;
  std::span<const T> values_;
};

bool must_read(const ArrayStamp& known, const Array& array) {
  if (array.rows() == 0 || known.matches(array)) return false;
  return array.device().is_cpu() || !array.range()->writable_export();
}

bool is_finite(const Vec3f& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

}  // namespace

void EditedValues::check_bodies(const Model& m) {
  const Array* const arrays[kBodyArrays] = {&m.body_mass, &m.body_inertia, &m.body_com,
                                            &m.body_flags};
  bool any = false;
  for (size_t k = 0; k < kBodyArrays; ++k) any = any || must_read(bodies_[k], *arrays[k]);
  if (!any) return;
  const OnHost<float> mass(m.body_mass);
  const OnHost<Mat33f> inertia(m.body_inertia);
  const OnHost<Vec3f> com(m.body_com);
  const OnHost<int32_t> flags(m.body_flags);
  for (size_t b = 0; b < mass.size(); ++b) {
    require(is_finite(com[b]), ErrorKind::Value, solver_, ": model.body_com[", b,
            "]: expected finite numbers, got (", com[b].x, ", ", com[b].y, ", ", com[b].z, ")");
    if (has_flag(flags[b], BodyFlags::KINEMATIC)) continue;
    require(mass[b] > 0.0f && std::isfinite(mass[b]), ErrorKind::Value, solver_,
            ": model.body_mass[", b, "]: expected a finite number > 0 of a dynamic body, got ",
            mass[b]);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const float x = inertia[b].m[i][j];
        require(std::isfinite(x) && (i != j || x > 0.0f), ErrorKind::Value, solver_,
                ": model.body_inertia[", b, "]: expected finite numbers, > 0 on the diagonal, got ",
                x, " in row ", i, ", column ", j);
      }
  }
  for (size_t k = 0; k < kBodyArrays; ++k) bodies_[k].set(*arrays[k]);
}

void EditedValues::check_shapes(const Model& m) {
  struct Setting {
    const char* name;
    const DeviceArray<float>& array;
    bool may_be_negative = false;
  };
  const Setting settings[kShapeArrays] = {
      {"shape_material_ke", m.shape_material_ke}, {"shape_material_kd", m.shape_material_kd},
      {"shape_material_kf", m.shape_material_kf}, {"shape_material_ka", m.shape_material_ka},
      {"shape_material_mu", m.shape_material_mu}, {"shape_gap", m.shape_gap},
      {"shape_margin", m.shape_margin, true}};
  for (size_t k = 0; k < kShapeArrays; ++k) {
    const Setting& setting = settings[k];
    if (!must_read(shapes_[k], setting.array)) continue;
    const OnHost<float> values(setting.array);
    for (size_t s = 0; s < values.size(); ++s)
      require(std::isfinite(values[s]) && (setting.may_be_negative || values[s] >= 0.0f),
              ErrorKind::Value, solver_, ": model.", setting.name, "[", s, "]: expected a finite ",
              setting.may_be_negative ? "number" : "number >= 0", ", got ", values[s]);
    shapes_[k].set(setting.array);
  }
}

void EditedValues::check(const Model& model) {
  const Unobserved unobserved;
  check_bodies(model);
  check_shapes(model);
}

}  // namespace novaphy
