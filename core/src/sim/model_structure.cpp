// Which joints and articulations there are: what may not change after a model is made.
#include <algorithm>

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

void check_same(std::string_view function, const char* name, const Array& array,
                const std::vector<int32_t>& made) {
  const std::vector<int32_t> now = numbers_of(array);
  const auto at =
      static_cast<size_t>(std::mismatch(now.begin(), now.end(), made.begin()).first - now.begin());
  if (at == now.size()) return;
  const size_t width = now.size() / array.rows();
  fail(ErrorKind::Value, function, ": model.", name, "[", at / width, "]: expected ", made[at],
       " as the model was made (which joints there are does not change; make another model), got ",
       now[at]);
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

void Model::check_structure(std::string_view function) const {
  if (joint_count() == 0 || structure_ == nullptr) return;
#define NOVAPHY_STRUCTURE_ARRAY(name) &name,
  const Array* const arrays[] = {NOVAPHY_MODEL_STRUCTURE(NOVAPHY_STRUCTURE_ARRAY)};
#undef NOVAPHY_STRUCTURE_ARRAY
  depend_on(arrays);
  const Unobserved unobserved;
  const auto check = [&](const char* name, const Array& array, DerivedStamp& stamp,
                         const std::vector<int32_t>& made) {
    if (stamp.matches(array)) [[likely]]
      return;
    const std::lock_guard lock(derived_mutex_);
    check_same(function, name, array, made);
    stamp.set(array);
  };
#define NOVAPHY_CHECK_STRUCTURE(name) \
  check(#name, this->name, structure_stamps_.name, structure_->name);
  NOVAPHY_MODEL_STRUCTURE(NOVAPHY_CHECK_STRUCTURE)
#undef NOVAPHY_CHECK_STRUCTURE
}

}  // namespace novaphy
