// Checks of the arrays that may not change after finalize: the structure of joints and
// articulations, and worlds.
#include <algorithm>
#include <bit>
#include <type_traits>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {
namespace {

std::vector<int32_t> numbers_of(const Array& array) {
  std::vector<int32_t> numbers(array.bytes() / sizeof(int32_t));
  if (!numbers.empty()) array.copy_to_host(numbers.data(), array.bytes());
  return numbers;
}

// Checks that an array has its original values. `real`: whether the integers are the bits of
// floats.
void check_same(std::string_view function, const char* name, const Array& array,
                const std::vector<int32_t>& made, bool real) {
  const std::vector<int32_t> now = numbers_of(array);
  const auto at =
      static_cast<size_t>(std::mismatch(now.begin(), now.end(), made.begin()).first - now.begin());
  if (at == now.size()) return;
  const size_t width = now.size() / array.rows();
  const auto number = [real](int32_t value) {
    return real ? static_cast<double>(std::bit_cast<float>(value)) : value;
  };
  fail(ErrorKind::Value, function, ": model.", name, "[", at / width, "]: expected ",
       number(made[at]),
       " as the model was made (which joints there are does not change; make another model), got ",
       number(now[at]));
}

}  // namespace

void Model::keep_structure() {
  auto kept = std::make_shared<Structure>();
#define NOVAPHY_KEEP_STRUCTURE(name)   \
  kept->name = numbers_of(this->name); \
  structure_stamps_.name.set(this->name);
  NOVAPHY_MODEL_STRUCTURE(NOVAPHY_KEEP_STRUCTURE)
#undef NOVAPHY_KEEP_STRUCTURE
  structure_ = std::move(kept);
}

void Model::check_worlds(std::string_view function) const {
  const std::pair<const char*, const DeviceArray<int32_t>*> arrays[] = {
      {"particle_world", &particle_world},
      {"body_world", &body_world},
      {"shape_world", &shape_world}};
  for (size_t k = 0; k < world_stamps_.size(); ++k) {
    const auto& [name, array] = arrays[k];
    if (world_stamps_[k].matches(*array)) [[likely]]
      continue;
    const UntrackedScope untracked;
    const std::lock_guard lock(derived_mutex_);
    const std::vector<int32_t> world = array->to_host();
    for (size_t row = 0; row < world.size(); ++row)
      require(world[row] >= -1 && world[row] < world_count(), ErrorKind::Index, function,
              ": model.", name, "[", row, "]: expected -1 to ", world_count() - 1, ", got ",
              world[row]);
    world_stamps_[k].set(*array);
  }
}

void Model::check_structure(std::string_view function) const {
  check_worlds(function);
  if (joint_count() == 0 || structure_ == nullptr) return;
#define NOVAPHY_STRUCTURE_ARRAY(name) &name,
  const Array* const arrays[] = {NOVAPHY_MODEL_STRUCTURE(NOVAPHY_STRUCTURE_ARRAY)};
#undef NOVAPHY_STRUCTURE_ARRAY
  depend_on(arrays);
  const UntrackedScope untracked;
  const auto check = [&](const char* name, const Array& array, DerivedStamp& stamp,
                         const std::vector<int32_t>& made, bool real) {
    if (stamp.matches(array)) [[likely]]
      return;
    const std::lock_guard lock(derived_mutex_);
    check_same(function, name, array, made, real);
    stamp.set(array);
  };
#define NOVAPHY_CHECK_STRUCTURE(name)                                \
  check(#name, this->name, structure_stamps_.name, structure_->name, \
        std::is_same_v<decltype(Model::name), DeviceArray<Vec2f>>);
  NOVAPHY_MODEL_STRUCTURE(NOVAPHY_CHECK_STRUCTURE)
#undef NOVAPHY_CHECK_STRUCTURE
}

}  // namespace novaphy
