// Queries about the contents of a tape, and the memory of its gradients.
#include <algorithm>
#include <utility>

#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "tape_impl.h"

namespace nova {

using novaphy::Storage;

void Tape::reset() {
  impl_->check_no_body("Tape.reset");
  impl_->forget();
}
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

void Tape::zero() {
  for (Impl::Node& n : impl_->nodes) {
    GradInfo& info = grad_info(*n.range);
    info.state = GradState::Zero;  // so that the next contribution stores
    if (OpList* graph = current_capture()) {
      info.zeroed_in_capture = graph->id();
      graph->gradient(n.range, info.state);
    }
    // Code that holds a leaf's gradient must read 0 now. Other gradients are set by backward.
    if (!n.ever_written && info.grad) submit_fill(info.grad, 0.0f);
  }
}

const std::shared_ptr<Range>* Tape::Impl::GradientPool::take(const Range& like) {
  const auto fits = [&](const std::shared_ptr<Range>* place) {
    return (*place)->bytes() == like.bytes() &&
           (*place)->storage().device() == like.storage().device();
  };
  const auto at = std::find_if(free_.rbegin(), free_.rend(), fits);
  if (at == free_.rend())
    return &all_.emplace_back(
        Storage::allocate(like.bytes(), like.storage().device(), false)->range());
  const std::shared_ptr<Range>* place = *at;
  free_.erase(std::next(at).base());
  return place;
}
void Tape::Impl::GradientPool::give_back(const std::shared_ptr<Range>* place) {
  free_.push_back(place);
}
void Tape::Impl::GradientPool::clear() {
  all_.clear();
  free_.clear();
}

}  // namespace nova
