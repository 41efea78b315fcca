#define NOVAPHY_ISA_NAME "avx512"
#define NOVAPHY_ISA_LANES 16
#define NOVAPHY_ISA_FUNCTION isa_avx512
#define NOVAPHY_ISA_SCALAR_ROWS 3
#include "isa.inc"
