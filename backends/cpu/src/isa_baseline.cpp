#define NOVAPHY_ISA_NAME "baseline"
#define NOVAPHY_ISA_LANES 4
#define NOVAPHY_ISA_FUNCTION isa_baseline
#define NOVAPHY_ISA_SCALAR_ROWS 4
#include "isa.inc"
