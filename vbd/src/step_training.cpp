// Tables for materials and rest shapes of elements that may change between replays (see
// VbdStepInputs::trains_elements).
#include <algorithm>
#include <span>
#include <vector>

#include "element_arrays.h"
#include "novaphy/core/error.h"
#include "step.h"

namespace novaphy::vbd {

// Records for each element which material values may differ from 0 with the current slots.
void Step::reserve_training() {
  Tables& t = *tables_;
  if (!t.trained.empty()) return;
  const UntrackedScope untracked;
  const Model& m = host_model();
  // Values may differ from 0 if the element has slots. An element that lacks a corner, or has only
  // kinematic particles, has no slots and no effect. Its material may have any values.
  for_each_kind([&](auto is) {
    using Element = typename decltype(is)::Slot;
    std::vector<int32_t> allowed;
    Element::with_indices(m, [&](const char*, const Array& indices) {
      const auto* const corners = static_cast<const int32_t*>(indices.raw());
      for (size_t e = 0; e < indices.rows(); ++e) {
        const std::span of(corners + e * Element::kCorners, size_t{Element::kCorners});
        const bool is_whole = std::none_of(of.begin(), of.end(), [](int32_t p) { return p < 0; });
        const bool moves = is_whole && std::any_of(of.begin(), of.end(), [&](int32_t p) {
                             return !slots_.is_kinematic(p);
                           });
        allowed.push_back(moves ? 0 : kVbdAnyMaterial);
      }
    });
    Element::for_arrays(
        model_, [&](const char* name, const Array& array, int columns, ArrayUse use) {
          if (use != kMaterial) return;
          for (int slot = 0; slot < Element::kSlots; ++slot)
            for (const ColorSlots::Source& source : slots_.table(is.role + slot).of_particles)
              allowed[static_cast<size_t>(source.element)] = (1 << columns) - 1;
          t.trained.push_back({name, &array, upload<int32_t>(allowed, device())});
        });
  });
  std::erase_if(trained_, [](const Trained& old) { return old.allowed.range().use_count() <= 1; });
  trained_.insert(trained_.end(), t.trained.begin(), t.trained.end());
}

void Step::watch_materials() {
  reserve_training();
  for (const Trained& trained : tables_->trained)
    novaphy::run(kernels().material, static_cast<int64_t>(trained.array->rows()),
                 {.material = Untyped(*trained.array),
                  .width = trained.array->width(),
                  .allowed = trained.allowed});
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
