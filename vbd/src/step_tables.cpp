// Builds the tables of a step of VBD.
#include <algorithm>

#include "novaphy/core/assert.h"
#include "step.h"

namespace novaphy::vbd {
namespace {

// A color with at least this many large thread blocks keeps a device busy.
constexpr int64_t kManyBlocks = 256;

}  // namespace

void Step::build_tables(float dt) {
  const Model& m = host_model();
  forget_lists();
  slots_.set_constants(m, dt);  // the step writes the activations later
  NOVAPHY_ASSERT(std::is_sorted(colors().begin(), colors().end()));
  Tables& t = tables_.emplace();
  t.dt = dt;
  t.particle = upload<int32_t>(slots_.particles(), device());
  t.filled = upload<int32_t>(slots_.filled(), device());
  t.mass_by_h2 = upload<float>(slots_.masses_by_h2(), device());
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots_.table(role);
    if (table.sources.empty()) continue;
    t.begin[role] = upload<uint64_t>(table.begin, device());
    t.ints[role] = upload<int32_t>(table.ints, device());
    t.floats[role] = upload<float>(table.floats, device());
    if (table.damped) t.damped |= int64_t{1} << role;
    std::vector<int32_t> sources;
    for (const auto& [element, corner] : table.sources)
      sources.push_back(element < 0 ? -1 : 4 * element + corner);
    t.sources[role] = upload<int32_t>(sources, device());
  }
  find_block_groups();
}

// Chooses the largest thread block that fits into shared memory and still keeps the device busy.
void Step::find_block_groups() {
  if (on_cpu_) return;
  int64_t most_groups = 0;
  for (size_t c = 0; c + 1 < colors().size(); ++c)
    most_groups = std::max(most_groups, colors()[c + 1] - colors()[c]);
  const auto terms = [&](int64_t block_groups) {
    int64_t sum = 0;
    for (int role = 0; role < kRoles; ++role) {
      const std::vector<int64_t>& begin = slots_.table(role).begin;
      int64_t most = 0;
      for (size_t g = 0; g + 1 < begin.size(); ++g) most = std::max(most, begin[g + 1] - begin[g]);
      sum += (most * block_groups * kVbdLanes + 31) / 32 * 32;
    }
    return sum;
  };
  if (terms(1) <= kVbdBlockTerms) tables_->block_groups = 1;
  if (terms(kVbdLargeBlock) <= kVbdBlockTerms && most_groups >= kManyBlocks * kVbdLargeBlock)
    tables_->block_groups = kVbdLargeBlock;
}

void Step::reserve_iterates() {
  const UntrackedScope untracked;
  const auto iterations = static_cast<size_t>(options_.iterations);
  const size_t count = coarse() != nullptr ? 2 * iterations + 2 : iterations;
  if (iterates_.size() > count) iterates_.clear();
  while (iterates_.size() < count) iterates_.emplace_back(x_.rows(), device());
  if (coarse() == nullptr) return;
  const size_t systems = coarse()->search().rows();
  if (!searches_.empty() && searches_[0].rows() != systems) searches_.clear();
  while (searches_.size() < iterations) searches_.emplace_back(systems, device());
}

int32_t Step::halvings() const {
  int64_t count = 0;
  for (const Rows4& searches : searches_) {
    const Rows of_systems = download(searches);
    count += std::count_if(of_systems.begin(), of_systems.end(),
                           [](const Row& search) { return search.x < 1.0f; });
  }
  return static_cast<int32_t>(count);
}

}  // namespace novaphy::vbd
