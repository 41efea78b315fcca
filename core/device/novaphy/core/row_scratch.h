// <novaphy/core/row_scratch.h> for device code.
#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE& NAME = *(MEMORY)
