// Warnings of the engine. Nothing is printed: Python makes warnings of it.
#pragma once

#include <string>

#include "novaphy/core/error.h"
#include "novaphy/core/export.h"

namespace novaphy {

// Is called by warn(), on its thread; what it throws goes through the caller. Null: no one listens.
using WarningHandler = void (*)(const std::string& text);
NOVAPHY_CORE_API void set_warning_handler(WarningHandler handler);
NOVAPHY_CORE_API void warn(const std::string& text);

// The parts joined, as in an error.
template <class... Parts>
void warn_of(const Parts&... parts) {
  std::string text;
  (text.append(MessagePart(parts).text()), ...);
  warn(text);
}

}  // namespace novaphy
