#include "novaphy/core/sim/edited_values.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <span>
#include <string>
#include <vector>

#include "builder_checks.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "rest_shape.h"

namespace novaphy {
namespace {

enum class Rule {
  Finite,
  NotNegative,
  AtMostOne,
  Unread,
  Mass,
  Diagonal,
  NotZero,
  UnitVector,
  UnitFrame,
  UnitPose,
  RestPose,
  Elastic
};

struct Numbers {
  const char* name;
  const Array& array;
  Rule rule;
};

// Provides the numbers of an array on the host. An array on the CPU is not copied.
class ValuesOnHost {
 public:
  explicit ValuesOnHost(const Array& array) {
    const size_t count = array.bytes() / sizeof(float);
    if (array.device().is_cpu()) {
      values_ = {static_cast<const float*>(array.raw()), count};
    } else {
      copy_.resize(count);
      array.copy_to_host(copy_.data(), array.bytes());
      values_ = copy_;
    }
    width_ = count / array.rows();
  }
  const float* row(size_t r) const { return &values_[r * width_]; }
  size_t width() const { return width_; }

 private:
  std::vector<float> copy_;
  std::span<const float> values_;
  size_t width_;
};

bool must_read(const ArrayStamp& known, const Array& array) {
  if (array.rows() == 0 || known.matches(array)) return false;
  return array.device().is_cpu() || !array.range()->writable_export();
}

// Returns the determinant of a 2x2 or 3x3 matrix.
double determinant(const float* m, size_t width) {
  const auto at = [m](size_t k) { return static_cast<double>(m[k]); };
  if (width == 4) return at(0) * at(3) - at(1) * at(2);
  return at(0) * (at(4) * at(8) - at(5) * at(7)) - at(1) * (at(3) * at(8) - at(5) * at(6)) +
         at(2) * (at(3) * at(7) - at(4) * at(6));
}

double length(const float* v, size_t first, size_t width) {
  double squares = 0.0;
  for (size_t k = first; k < width; ++k) squares += double{v[k]} * double{v[k]};
  return std::sqrt(squares);
}

// Returns whether the rule allows number k of a row to be negative.
bool any_sign(Rule rule, size_t k) {
  const bool not_negative = rule == Rule::NotNegative || rule == Rule::AtMostOne ||
                            rule == Rule::Mass || (rule == Rule::Diagonal && k % 4 == 0) ||
                            (rule == Rule::Elastic && k != 1);
  return !not_negative;
}

void check_numbers(const char* solver, const Numbers& numbers) {
  const ValuesOnHost values(numbers.array);
  const size_t width = values.width();
  const Rule rule = numbers.rule;
  for (size_t row = 0; row < numbers.array.rows(); ++row) {
    const float* const v = values.row(row);
    const auto expect = [&](bool good, const char* expected, double got) {
      if (!good)
        fail(ErrorKind::Value, solver, ": model.", numbers.name, "[", row, "]: expected ", expected,
             ", got ", got);
    };
    for (size_t k = 0; k < width; ++k) {
      const bool signless = any_sign(rule, k);
      if (std::isfinite(v[k]) && (signless || v[k] >= 0.0f)) [[likely]]
        continue;
      fail(ErrorKind::Value, solver, ": model.", numbers.name, "[", row, "]: expected ",
           width == 1 ? "a finite number" : "finite numbers", signless ? "" : " >= 0", ", got ",
           v[k]);
    }
    switch (rule) {
      case Rule::Finite:
      case Rule::NotNegative:
      case Rule::Diagonal:
      case Rule::Elastic:
        break;
      case Rule::Unread:
        expect(v[0] == 0.0f, "0, which only solvers of articulations read otherwise", double{v[0]});
        break;
      case Rule::AtMostOne:
        expect(v[0] <= 1.0f, "at most 1", double{v[0]});
        break;
      case Rule::Mass:
        expect(v[0] == 0.0f || std::isfinite(1.0f / v[0]), "0 or a mass whose inverse is finite",
               double{v[0]});
        break;
      case Rule::NotZero:
        expect(length(v, width == 7 ? 3 : 0, width) > 0.0,
               width == 7 ? "a quaternion that is not zero" : "a vector that is not zero", 0.0);
        break;
      case Rule::UnitVector:
        expect(std::abs(length(v, 0, 3) - 1.0) <= 1e-3, "a vector of length 1", length(v, 0, 3));
        break;
      case Rule::UnitFrame:
        expect(std::abs(length(v, 3, 7) - 1.0) <= 1e-3, "a quaternion of length 1",
               length(v, 3, 7));
        break;
      case Rule::UnitPose:
        expect(std::abs(length(v, 3, 7) - 1.0) <= 1e-5, "a quaternion of length 1 (to 1e-5)",
               length(v, 3, 7));
        break;
      case Rule::RestPose:
        expect(determinant(v, width) > 0.0, "a determinant > 0", determinant(v, width));
        break;
    }
  }
}

// Checks shape_scale by the same rules as ModelBuilder.
void check_sizes(const char* solver, const Model& m) {
  const std::vector<int32_t> type = m.shape_type.to_host();
  const std::vector<Vec3f> scale = m.shape_scale.to_host();
  for (size_t k = 0; k < scale.size(); ++k)
    if (const auto of = static_cast<GeoType>(type[k]); of != GeoType::NONE)
      detail::checked_scale(std::string(solver) + ": model.shape_scale[" + std::to_string(k) + "]",
                            of, scale[k]);
}

// Checks symmetry by the same rule as ModelBuilder.
bool is_symmetric(const float* m) {
  double largest = 0.0;
  for (size_t k = 0; k < 9; ++k) largest = std::max(largest, std::abs(double{m[k]}));
  const auto same = [&](size_t a, size_t b) {
    return std::abs(double{m[a]} - double{m[b]}) <= 1e-5 * largest;
  };
  return same(1, 3) && same(2, 6) && same(5, 7);
}
bool is_positive_definite(const float* m) {
  const double minor = double{m[0]} * double{m[4]} - double{m[3]} * double{m[3]};
  const double lower[9] = {m[0], m[3], m[6], m[3], m[4], m[7], m[6], m[7], m[8]};
  const auto at = [&](size_t k) { return lower[k]; };
  const double whole = at(0) * (at(4) * at(8) - at(5) * at(7)) -
                       at(1) * (at(3) * at(8) - at(5) * at(6)) +
                       at(2) * (at(3) * at(7) - at(4) * at(6));
  return m[0] > 0.0f && minor > 0.0 && whole > 0.0;
}

bool is_finite(const float* v, size_t count) {
  return std::all_of(v, v + count, [](float x) { return std::isfinite(x); });
}

}  // namespace

void EditedValues::check_bodies(const Model& m) {
  const Array* const arrays[kBodyArrays] = {&m.body_mass,  &m.body_inertia,  &m.body_com,
                                            &m.body_flags, &m.body_inv_mass, &m.body_inv_inertia};
  bool any = false;
  for (size_t k = 0; k < kBodyArrays; ++k) any = any || must_read(bodies_[k], *arrays[k]);
  if (!any) return;
  const ValuesOnHost mass(m.body_mass), inertia(m.body_inertia), com(m.body_com),
      inv_mass(m.body_inv_mass), inv_inertia(m.body_inv_inertia);
  const std::vector<int32_t> flags = m.body_flags.to_host();
  for (size_t b = 0; b < flags.size(); ++b) {
    const float* const c = com.row(b);
    require(is_finite(c, 3), ErrorKind::Value, solver_, ": model.body_com[", b,
            "]: expected finite numbers, got (", c[0], ", ", c[1], ", ", c[2], ")");
    if (has_flag(flags[b], BodyFlags::KINEMATIC)) continue;
    require(*mass.row(b) > 0.0f && std::isfinite(*mass.row(b)), ErrorKind::Value, solver_,
            ": model.body_mass[", b, "]: expected a finite number > 0 of a dynamic body, got ",
            *mass.row(b));
    for (size_t k = 0; k < 9; ++k) {
      const float x = inertia.row(b)[k];
      require(std::isfinite(x) && (k % 4 != 0 || x > 0.0f), ErrorKind::Value, solver_,
              ": model.body_inertia[", b, "]: expected finite numbers, > 0 on the diagonal, got ",
              x, " in row ", k / 3, ", column ", k % 3);
    }
    require(is_symmetric(inertia.row(b)) && is_positive_definite(inertia.row(b)), ErrorKind::Value,
            solver_, ": model.body_inertia[", b,
            "]: expected a symmetric, positive definite matrix, got ((", inertia.row(b)[0], ", ",
            inertia.row(b)[1], ", ", inertia.row(b)[2], "), (", inertia.row(b)[3], ", ",
            inertia.row(b)[4], ", ", inertia.row(b)[5], "), (", inertia.row(b)[6], ", ",
            inertia.row(b)[7], ", ", inertia.row(b)[8], "))");
    require(is_finite(inv_mass.row(b), 1) && *inv_mass.row(b) >= 0.0f, ErrorKind::Value, solver_,
            ": model.body_inv_mass[", b, "]: expected a finite number >= 0, got ",
            *inv_mass.row(b));
    require(is_finite(inv_inertia.row(b), 9), ErrorKind::Value, solver_,
            ": model.body_inv_inertia[", b, "]: expected finite numbers");
  }
  for (size_t k = 0; k < kBodyArrays; ++k) bodies_[k].set(*arrays[k]);
}

void EditedValues::check_limits(const Model& m) {
  if (!must_read(limits_[0], m.joint_limit_lower) && !must_read(limits_[1], m.joint_limit_upper))
    return;
  const ValuesOnHost lower(m.joint_limit_lower), upper(m.joint_limit_upper);
  for (size_t k = 0; k < m.joint_limit_lower.rows(); ++k)
    require(*lower.row(k) <= *upper.row(k), ErrorKind::Value, solver_, ": model.joint_limit_lower[",
            k, "]: expected at most joint_limit_upper, ", *upper.row(k), ", got ", *lower.row(k));
  limits_[0].set(m.joint_limit_lower);
  limits_[1].set(m.joint_limit_upper);
}

void EditedValues::check_arrays(const Model& m) {
  require(m.actuator_count() == 0, ErrorKind::NotImplemented, solver_,
          ": model: expected no actuators, which only solvers of articulations have, got ",
          m.actuator_count());
  const Numbers all[kArrays] = {
#define NOVAPHY_NUMBERS(name, rule) {#name, m.name, Rule::rule},
      NOVAPHY_EDITED_ARRAYS(NOVAPHY_NUMBERS)
#undef NOVAPHY_NUMBERS
  };
  for (size_t k = 0; k < kArrays; ++k) {
    if (!must_read(arrays_[k], all[k].array)) continue;
    check_numbers(solver_, all[k]);
    if (&all[k].array == &m.shape_scale) check_sizes(solver_, m);
    if (all[k].rule == Rule::Elastic) detail::check_elasticity(solver_, m);
    arrays_[k].set(all[k].array);
  }
  check_limits(m);
}

// Runs a check now and, while a capture records on the CPU, before every replay.
template <class Check>
void EditedValues::check_all(const Model& model, Check check) {
  const UntrackedScope untracked;
  check(*this, model);
  LaunchRecorder* const recorder = launch_recorder();
  if (recorder == nullptr || !model.device().is_cpu()) return;
  recorder->before_replay(id_, [check, values = *this, owner = model.shared_from_this()]() mutable {
    const UntrackedScope of_replays;
    check(values, *owner);
  });
}

void EditedValues::check(const Model& model) {
  check_all(model, [](EditedValues& values, const Model& m) {
    values.check_bodies(m);
    values.check_arrays(m);
  });
}

void EditedValues::check_joints(const Model& model) {
  check_all(model, [](EditedValues& values, const Model& m) { values.check_joint_arrays(m); });
}

namespace {
void check_target_modes(const char* solver, const Model& m) {
  const std::vector<int32_t> modes = m.joint_target_mode.to_host();
  for (size_t k = 0; k < modes.size(); ++k)
    require(modes[k] >= 0 && modes[k] <= static_cast<int32_t>(JointTargetMode::EFFORT),
            ErrorKind::Value, solver, ": model.joint_target_mode[", k,
            "]: expected a JointTargetMode, got ", modes[k]);
}
}  // namespace

void EditedValues::check_joint_arrays(const Model& m) {
  const Numbers arrays[] = {
      {"joint_armature", m.joint_armature, Rule::NotNegative},
      {"joint_damping", m.joint_damping, Rule::NotNegative},
      {"joint_friction", m.joint_friction, Rule::NotNegative},
      {"joint_target_ke", m.joint_target_ke, Rule::NotNegative},
      {"joint_target_kd", m.joint_target_kd, Rule::NotNegative},
      {"joint_limit_ke", m.joint_limit_ke, Rule::NotNegative},
      {"joint_limit_kd", m.joint_limit_kd, Rule::NotNegative},
      {"joint_effort_limit", m.joint_effort_limit, Rule::NotNegative},
      {"joint_velocity_limit", m.joint_velocity_limit, Rule::NotNegative},
      {"joint_limit_lower", m.joint_limit_lower, Rule::Finite},
      {"joint_limit_upper", m.joint_limit_upper, Rule::Finite},
      {"joint_axis", m.joint_axis, Rule::UnitVector},
      {"joint_X_p", m.joint_X_p, Rule::UnitFrame},
      {"joint_X_c", m.joint_X_c, Rule::UnitFrame},
      {"actuator_gear", m.actuator_gear, Rule::Finite},
      {"actuator_frame", m.actuator_frame, Rule::UnitFrame},
      {"actuator_reference", m.actuator_reference, Rule::UnitFrame},
      {"actuator_wrench", m.actuator_wrench, Rule::Finite},
      {"actuator_gain", m.actuator_gain, Rule::Finite},
      {"actuator_bias", m.actuator_bias, Rule::Finite},
      {"actuator_time", m.actuator_time, Rule::NotNegative},
      {"actuator_ctrl_range", m.actuator_ctrl_range, Rule::Finite},
      {"actuator_force_range", m.actuator_force_range, Rule::Finite},
      {"actuator_act_range", m.actuator_act_range, Rule::Finite},
      {"body_gravcomp", m.body_gravcomp, Rule::Finite},
      {"body_mass", m.body_mass, Rule::NotNegative},
      {"body_com", m.body_com, Rule::Finite},
      {"body_inertia", m.body_inertia, Rule::Diagonal},
      {"shape_material_mu", m.shape_material_mu, Rule::NotNegative},
      {"shape_material_restitution", m.shape_material_restitution, Rule::AtMostOne},
      {"shape_material_ke", m.shape_material_ke, Rule::NotNegative},
      {"shape_material_kd", m.shape_material_kd, Rule::NotNegative},
      {"shape_material_kf", m.shape_material_kf, Rule::NotNegative},
      {"shape_material_ka", m.shape_material_ka, Rule::NotNegative},
      {"shape_mixing", m.shape_mixing, Rule::Finite},
      {"shape_transform", m.shape_transform, Rule::UnitPose},
      {"shape_scale", m.shape_scale, Rule::NotNegative},
      {"shape_gap", m.shape_gap, Rule::NotNegative},
      {"shape_margin", m.shape_margin, Rule::Finite},
      {"body_fluid_box", m.body_fluid_box, Rule::NotNegative},
      {"body_fluid_frame", m.body_fluid_frame, Rule::Finite},
      {"fluid_density", m.fluid_density, Rule::NotNegative},
      {"fluid_viscosity", m.fluid_viscosity, Rule::NotNegative},
      {"fluid_wind", m.fluid_wind, Rule::Finite},
      {"gravity", m.gravity, Rule::Finite}};
  constexpr size_t kCount = std::size(arrays);
  joints_.resize(kCount + 1);
  for (size_t k = 0; k < kCount; ++k) {
    if (!must_read(joints_[k], arrays[k].array)) continue;
    check_numbers(solver_, arrays[k]);
    if (&arrays[k].array == &m.shape_scale) check_sizes(solver_, m);
    joints_[k].set(arrays[k].array);
  }
  check_limits(m);
  if (!must_read(joints_[kCount], m.joint_target_mode)) return;
  check_target_modes(solver_, m);
  joints_[kCount].set(m.joint_target_mode);
}

}  // namespace novaphy
