// Queries about the contents of a tape.
#include <utility>

#include "novaphy/nova/tape.h"
#include "tape_impl.h"

namespace nova {

void Tape::reset() { impl_->forget(); }
size_t Tape::size() const { return impl_->ops.size(); }
std::vector<std::string> Tape::op_names() const {
  std::vector<std::string> names;
  for (const auto& op : impl_->ops) names.push_back(impl_->op_name(op));
  return names;
}
size_t Tape::memory_bytes() const {
  return impl_->ops.capacity() * sizeof(Impl::Op) + impl_->uses.capacity() * sizeof(Impl::Use) +
         impl_->params.capacity() * sizeof(Param) +
         impl_->nodes.size() * (sizeof(Impl::Node) + 4 * sizeof(void*));
}

Tape::Witness::~Witness() = default;
void Tape::add_witness(std::shared_ptr<const Witness> witness) {
  impl_->witnesses.push_back(std::move(witness));
}
std::span<const std::shared_ptr<const Tape::Witness>> Tape::witnesses() const {
  return impl_->witnesses;
}
int64_t Tape::passes() const { return impl_->passes; }

}  // namespace nova
