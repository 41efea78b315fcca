#include "fcl_penetration.h"

namespace novaphy::detail {

bool has_fcl() { return false; }

struct FclHull::Impl {};

FclHull::FclHull(const geometry::HullView&) {}
FclHull::~FclHull() = default;
FclHull::FclHull(FclHull&&) noexcept = default;

std::optional<FclHull::Penetration> FclHull::penetration(const FclHull&, const Transformf&) const {
  return std::nullopt;
}

}  // namespace novaphy::detail
