// A plugin without code that was built ahead.
#include "ahead.h"

namespace novaphy::gpu {
AheadData ahead_data() { return {nullptr, 0}; }
}  // namespace novaphy::gpu
