// The inputs of a step of VBD, and the destinations of its derivatives: arrays of a device, or
// memory of the host.
#pragma once

#include <type_traits>
#include <vector>

#include "novaphy/core/launch_arguments.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/rows_kernels.h"

namespace novaphy::vbd {

// Null where there are no rows.
template <class T>
const DeviceArray<T>* if_any(const DeviceArray<T>& array) {
  return array.rows() != 0 ? &array : nullptr;
}

// Of arrays that outlive it.
struct StepInputs {
  ReadsRow<Vec3f> q, qd, f;
  const DeviceArray<float>&tri_activation, &tet_activation;
  const Contacts* contacts;           // null: none
  Optional<ReadsRow<Vec3f>> targets;  // of the kinematic particles; null: they stay
  float dt;
  Optional<UpdatesRow<VbdRow>> last_velocity;  // see VbdStepInputs
  bool trains_elements = false;                // see VbdLaunchInputs

  StepInputs(const Model& m, const VbdStepInputs& in)
      : q(direct(in.particle_q)),
        qd(direct(in.particle_qd)),
        f(direct(in.particle_f)),
        tri_activation(in.tri_activation != nullptr ? *in.tri_activation
                                                    : m.particle_tri_activation),
        tet_activation(in.tet_activation != nullptr ? *in.tet_activation
                                                    : m.particle_tet_activation),
        contacts(in.contacts),
        targets(direct(in.targets)),
        dt(in.dt),
        last_velocity(direct(reinterpret_cast<VbdRow*>(const_cast<Vec4f*>(in.last_velocity)))) {}
  explicit StepInputs(const VbdLaunchInputs& in)
      : q(in.q),
        qd(in.qd),
        f(in.f),
        tri_activation(in.tri_activation),
        tet_activation(in.tet_activation),
        contacts(in.contacts),
        targets(if_any(in.targets)),
        dt(in.dt),
        last_velocity(if_any(in.last_velocity)),
        trains_elements(in.trains_elements) {}
};

// The memory of an argument on the CPU.
template <class T, uint8_t kAccess, bool kOwnRow>
T* on_host(const novaphy::detail::Argument<T, kAccess, kOwnRow>& a) {
  const Range* const range = range_of(a.word());
  return range != nullptr ? static_cast<T*>(range->data()) : a.rows();
}

// The same of any device: a copy, where it is an array that the host cannot read.
template <class T>
struct OnHost {
  template <uint8_t kAccess, bool kOwnRow>
  explicit OnHost(const novaphy::detail::Argument<T, kAccess, kOwnRow>& a) {
    Range* const range = range_of(a.word());
    if (range == nullptr || range->device().is_cpu()) {
      rows = on_host(a);
      return;
    }
    copy.resize(range->bytes() / sizeof(T));
    const Array numbers(DType::float32, range->bytes() / sizeof(float), 1,
                        {range->storage().shared_from_this(), range});
    numbers.copy_to_host(copy.data(), range->bytes());
    rows = copy.data();
  }
  std::vector<std::remove_const_t<T>> copy;
  const T* rows = nullptr;  // null: none
};
// Where the derivatives by something go, or come from; null: they are not wanted, or 0.
template <class T>
struct Derivative : Optional<Updates<T>> {
  using Base = Optional<Updates<T>>;
  Derivative() : Base(nullptr) {}
  Derivative(T* rows) : Base(direct(rows)) {}
  Derivative(const T* rows) : Base(direct(const_cast<T*>(rows))) {}
  Derivative(const Array& array) : Base(nullptr) {
    if (array.rows() != 0) static_cast<Base&>(*this) = Base(Untyped(array));
  }
  bool is_wanted() const { return this->word() != 0; }
};
template <class T>
OnHost(const Derivative<T>&) -> OnHost<T>;

using StepDerivatives = VbdStepDerivatives<Derivative<float>, Derivative<Vec3f>>;

template <class Numbers, class Vectors>
StepDerivatives derivatives_of(const VbdStepDerivatives<Numbers, Vectors>& d) {
  return {d.particle_q,
          d.particle_qd,
          d.particle_f,
          d.targets,
          d.last_velocity,
          d.gravity,
          d.particle_mass,
          d.particle_radius,
          d.particle_spring_stiffness,
          d.particle_spring_damping,
          d.particle_spring_rest_length,
          d.particle_tri_pose,
          d.particle_tri_area,
          d.particle_tri_material,
          d.particle_tri_activation,
          d.particle_edge_material,
          d.particle_edge_rest_angle,
          d.particle_edge_rest_length,
          d.particle_tet_pose,
          d.particle_tet_material,
          d.particle_tet_activation,
          d.shape_margin,
          d.shape_material_ke,
          d.shape_material_kd,
          d.shape_material_mu};
}

// Whether a derivative by a damping is wanted, for which its terms run although it is 0.
inline bool wants_damping(const StepDerivatives& d) {
  return d.particle_tri_material.is_wanted() || d.particle_edge_material.is_wanted() ||
         d.particle_tet_material.is_wanted();
}
// Whether a derivative by a rest shape is wanted.
inline bool wants_weights(const StepDerivatives& d) {
  return d.particle_tri_pose.is_wanted() || d.particle_tet_pose.is_wanted();
}

}  // namespace novaphy::vbd
