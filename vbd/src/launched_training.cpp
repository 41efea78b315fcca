// Materials and rest shapes that replays read as they are then: see
// VbdLaunchInputs::trains_elements.
#include <algorithm>
#include <span>
#include <vector>

#include "launched_step.h"
#include "novaphy/core/error.h"
#include "vbd_kernels.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// Never destroyed, as those of launched_step.cpp.
struct Kernels {
  DeviceKernel material{vbd_material, detail::vbd_kernels_text};
  DeviceKernel spring{vbd_spring_numbers, detail::vbd_kernels_text};
  DeviceKernel triangle{vbd_triangle_numbers, detail::vbd_kernels_text};
  DeviceKernel hinge{vbd_hinge_numbers, detail::vbd_kernels_text};
  DeviceKernel tetrahedron{vbd_tetrahedron_numbers, detail::vbd_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

}  // namespace

// What put_numbers needs, for the tables as they are.
void LaunchedStep::reserve_training() {
  Tables& t = *tables_;
  if (!t.trained.empty()) return;
  const Unobserved unobserved;
  const Device device = model_.device();
  const Model& m = on_cpu_ ? model_ : *copy_;
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots_.table(static_cast<Role>(role));
    std::vector<int32_t> sources;
    for (const auto& [element, corner] : table.sources)
      sources.push_back(element < 0 ? -1 : 4 * element + corner);
    t.sources[role] = upload<int32_t>(sources, device);
  }
  // `columns`: of coefficients that may be other than 0 where the element acts. Elements without a
  // corner, or over held particles alone, have no part, and may hold anything.
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
    t.trained.push_back({name, &array, upload<int32_t>(allowed, device)});
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
void LaunchedStep::put_numbers(const VbdLaunchInputs& in) const {
  const Tables& t = *tables_;
  const Model& m = model_;
  const Device device = m.device();
  const auto put = [&](const DeviceKernel& kernel, Role role,
                       std::initializer_list<LaunchArgument> of_elements) {
    std::vector<LaunchArgument> a = {reads_row("source", t.sources[role]),
                                     updates("floats", t.floats[role]),
                                     number(int64_t{slots_.lanes()}), number(t.dt)};
    a.insert(a.end(), of_elements);
    kernel.launch(device, static_cast<int64_t>(t.sources[role].rows()), a);
  };
  for (const Trained& trained : t.trained)
    kernels().material.launch(
        device, static_cast<int64_t>(trained.array->rows()),
        {reads(trained.name, *trained.array), number(static_cast<int64_t>(trained.array->width())),
         updates_row("allowed", trained.allowed)});
  put(kernels().spring, kSpring,
      {reads("particle_spring_stiffness", m.particle_spring_stiffness),
       reads("particle_spring_damping", m.particle_spring_damping),
       reads("particle_spring_rest_length", m.particle_spring_rest_length)});
  put(kernels().triangle, kTriangle,
      {reads("particle_tri_pose", m.particle_tri_pose),
       reads("particle_tri_area", m.particle_tri_area),
       reads("particle_tri_material", m.particle_tri_material),
       reads("particle_tri_activation", in.tri_activation)});
  for (const Role role : {kHingeOpposite, kHingeEnd})
    put(kernels().hinge, role,
        {reads("particle_edge_material", m.particle_edge_material),
         reads("particle_edge_rest_length", m.particle_edge_rest_length),
         reads("particle_edge_rest_angle", m.particle_edge_rest_angle)});
  put(kernels().tetrahedron, kTetrahedron,
      {reads("particle_tet_pose", m.particle_tet_pose),
       reads("particle_tet_material", m.particle_tet_material),
       reads("particle_tet_activation", in.tet_activation)});
}

void LaunchedStep::check_trained() const {
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
