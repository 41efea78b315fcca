// Materials and rest shapes that replays read as they are then: see
// VbdStepInputs::trains_elements.
#include <algorithm>
#include <span>
#include <vector>

#include "novaphy/core/error.h"
#include "parameter_arrays.h"
#include "step.h"

namespace novaphy::vbd {
// What put_numbers needs, for the tables as they are.
void Step::reserve_training() {
  Tables& t = *tables_;
  if (!t.trained.empty()) return;
  const Unobserved unobserved;
  const Model& m = host_model();
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots_.table(static_cast<Role>(role));
    std::vector<int32_t> sources;
    for (const auto& [element, corner] : table.sources)
      sources.push_back(element < 0 ? -1 : 4 * element + corner);
    t.sources[role] = upload<int32_t>(sources, device());
  }
  // `columns`: of coefficients that may be other than 0 where the element acts. Elements without a
  // corner, or over kinematic particles alone, have no part, and may hold anything.
  const auto add = [&](const char* name, const Array& array, const Array& indices, int corners,
                       Role role, int32_t columns) {
    const auto* const corner = static_cast<const int32_t*>(indices.raw());
    std::vector<int32_t> allowed;
    for (size_t e = 0; e < array.rows(); ++e) {
      const std::span<const int32_t> of_element(corner + e * static_cast<size_t>(corners),
                                                static_cast<size_t>(corners));
      const bool is_whole =
          std::none_of(of_element.begin(), of_element.end(), [](int32_t p) { return p < 0; });
      const bool moves = is_whole && std::any_of(of_element.begin(), of_element.end(),
                                                 [&](int32_t p) { return !slots_.is_held(p); });
      allowed.push_back(moves ? 0 : kVbdAnyMaterial);
    }
    for (const Role of : {role, role == kHingeEnd ? kHingeOpposite : role})
      for (const ColorSlots::Source& source : slots_.table(of).of_particles)
        allowed[static_cast<size_t>(source.element)] = columns;
    t.trained.push_back({name, &array, upload<int32_t>(allowed, device())});
  };
  add("particle_spring_stiffness", model_.particle_spring_stiffness, m.particle_spring_indices, 2,
      kSpring, 0b1);
  add("particle_spring_damping", model_.particle_spring_damping, m.particle_spring_indices, 2,
      kSpring, 0b1);
  add("particle_tri_material", model_.particle_tri_material, m.particle_tri_indices, 3, kTriangle,
      0b00111);
  add("particle_edge_material", model_.particle_edge_material, m.particle_edge_indices, 4,
      kHingeEnd, 0b11);
  add("particle_tet_material", model_.particle_tet_material, m.particle_tet_indices, 4,
      kTetrahedron, 0b111);
  std::erase_if(trained_, [](const Trained& old) { return old.allowed.range().use_count() <= 1; });
  trained_.insert(trained_.end(), t.trained.begin(), t.trained.end());
}

// The numbers of all slots, from the model as it is.
void Step::put_numbers(const StepInputs& in) const {
  const Tables& t = *tables_;
  for (const Trained& trained : t.trained)
    novaphy::run(kernels().material, static_cast<int64_t>(trained.array->rows()),
                 {.material = Untyped(*trained.array),
                  .width = trained.array->width(),
                  .allowed = trained.allowed});
  const auto of_step = [&](const Array& array) {
    if (&array == &model_.particle_tri_activation) return Untyped(activation_of(in, kTriangle));
    if (&array == &model_.particle_tet_activation) return Untyped(activation_of(in, kTetrahedron));
    return Untyped(array);
  };
  for (int role = 0; role < kRoles; ++role)
    novaphy::run(
        kernels().numbers, static_cast<int64_t>(t.sources[role].rows()),
        {.source = t.sources[role],
         .floats = t.floats[role],
         .role = role,
         .lanes = slots_.lanes(),
         .h = t.dt,
         .parameters = parameter_arrays(static_cast<Role>(role), model_, Array(), of_step)});
}

void Step::check_trained() const {
  for (const Trained& trained : trained_) {
    std::vector<int32_t> allowed = trained.allowed.to_host();
    const auto bad = std::find_if(allowed.begin(), allowed.end(),
                                  [](int32_t bits) { return (bits & kVbdBadMaterial) != 0; });
    if (bad == allowed.end()) continue;
    const auto e = bad - allowed.begin();
    for (int32_t& bits : allowed) bits &= ~kVbdBadMaterial;
    DeviceArray<int32_t>(trained.allowed).copy_from_host(std::span<const int32_t>(allowed));
    fail(ErrorKind::Runtime, "SolverVBD.step", ": a replay since this was last asked: model.",
         trained.name, "[", e,
         "]: expected numbers >= 0, and 0 where all of the element were 0 when the capture was "
         "recorded; record it anew");
  }
}

}  // namespace novaphy::vbd
