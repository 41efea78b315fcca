// Replaces <novaphy/core/row_scratch.h> in device code.
#include "novaphy/core/row_stack.h"

#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE& NAME = *(MEMORY)

namespace novaphy {
constexpr int64_t kRowStack = kDeviceRowStack;

inline double* thread_numbers(int64_t) { return nullptr; }
}  // namespace novaphy
