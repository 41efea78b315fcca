// Warnings of the engine. The engine never prints; the Python binding turns a warning into a Python
// warning.
#pragma once

#include <string>

#include "novaphy/core/error.h"
#include "novaphy/core/export.h"

namespace novaphy {

// warn() calls the handler on the calling thread. An exception of the handler passes to the caller
// of warn(). Without a handler (null), warnings are dropped.
using WarningHandler = void (*)(const std::string& text);
NOVAPHY_CORE_API void set_warning_handler(WarningHandler handler);
NOVAPHY_CORE_API void warn(const std::string& text);

// Warns with the parts joined to one text, as in an error message.
template <class... Parts>
void warn_of(const Parts&... parts) {
  std::string text;
  (text.append(MessagePart(parts).text()), ...);
  warn(text);
}

}  // namespace novaphy
