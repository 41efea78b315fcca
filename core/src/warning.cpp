#include "novaphy/core/warning.h"

#include <atomic>

namespace novaphy {
namespace {
std::atomic<WarningHandler> of_process = nullptr;
}  // namespace

void set_warning_handler(WarningHandler handler) { of_process = handler; }

void warn(const std::string& text) {
  if (const WarningHandler handler = of_process) handler(text);
}

}  // namespace novaphy
