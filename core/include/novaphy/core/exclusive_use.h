// ExclusiveUse: a guard of memory that an object keeps between calls. Only one call at a time may
// use the memory. A call from a second thread is refused, because two calls would overwrite each
// other's results.
#pragma once

#include <algorithm>
#include <atomic>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"

namespace novaphy {

class ExclusiveUse {
 public:
  // Claims the memory for one call, from the constructor to the destructor. Throws
  // ErrorKind::Runtime if another call has the memory already. The message names `call` and
  // `owner`, the owner of the memory.
  class Scope {
   public:
    Scope(ExclusiveUse& use, const char* call, const char* owner) : use_(&use) {
      if (use.taken_.exchange(true, std::memory_order_acquire)) [[unlikely]]
        fail(ErrorKind::Runtime, call, ": ", owner,
             " is in use by another call; give every thread one of its own");
    }
    Scope(Scope&& other) noexcept : use_(std::exchange(other.use_, nullptr)) {}
    Scope& operator=(Scope&&) = delete;
    ~Scope() {
      if (use_ != nullptr) use_->taken_.store(false, std::memory_order_release);
    }

   private:
    ExclusiveUse* use_;
  };

 private:
  std::atomic<bool> taken_{false};
};

// The guards of all memory that recorded launches use. A replay claims all of them with take().
class ExclusiveUses {
 public:
  void add(const std::shared_ptr<ExclusiveUse>& use) {
    if (std::find(uses_.begin(), uses_.end(), use) == uses_.end()) uses_.push_back(use);
  }
  const std::vector<std::shared_ptr<ExclusiveUse>>& all() const { return uses_; }
  std::vector<ExclusiveUse::Scope> take(const char* call, const char* owner) const {
    std::vector<ExclusiveUse::Scope> scopes;
    scopes.reserve(uses_.size());
    for (const auto& use : uses_) scopes.emplace_back(*use, call, owner);
    return scopes;
  }
  void clear() { uses_.clear(); }

 private:
  std::vector<std::shared_ptr<ExclusiveUse>> uses_;
};

}  // namespace novaphy
