#include "novaphy/core/error.h"

namespace novaphy {

// Out of line, so that every library that throws or catches an Error shares one type description.
Error::~Error() = default;

}  // namespace novaphy
