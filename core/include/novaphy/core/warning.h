// What the engine wants to say without failing. Nothing is printed: Python makes warnings of it.
#pragma once

#include <string>

#include "novaphy/core/export.h"

namespace novaphy {

// Is called by warn(), on its thread; what it throws goes through the caller. Null: no one listens.
using WarningHandler = void (*)(const std::string& text);
NOVAPHY_CORE_API void set_warning_handler(WarningHandler handler);
NOVAPHY_CORE_API void warn(const std::string& text);

}  // namespace novaphy
