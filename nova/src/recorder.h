// Internal: this library's recorder of launches, on a thread while a tape, a capture or a deferred
// list is active there. Nests.
#pragma once

namespace nova::detail {
void enter_recording();
void leave_recording();
}  // namespace nova::detail
