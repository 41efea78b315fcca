// Compiled into plugins that have no ahead-of-time device code.
#include "ahead.h"

namespace novaphy::gpu {
AheadData ahead_data() { return {nullptr, 0}; }
}  // namespace novaphy::gpu
