#define NOVAPHY_ISA_NAME "avx2"
#define NOVAPHY_ISA_LANES 8
#define NOVAPHY_ISA_FUNCTION isa_avx2
#define NOVAPHY_ISA_SCALAR_ROWS 3
#include "isa.inc"
