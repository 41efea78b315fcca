// <novaphy/core/row_scratch.h> for device code.
#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE& NAME = *(MEMORY)
namespace novaphy {
constexpr int64_t kRowStack = 4096;
}  // namespace novaphy
