// Internal: installs this library's recorder of launches on a thread while a tape, a capture or a
// deferred list is active there. Calls may be nested.
#pragma once

namespace nova::detail {
void enter_recording();
void leave_recording();
}  // namespace nova::detail
