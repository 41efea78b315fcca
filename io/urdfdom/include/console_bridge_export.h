// Replaces the header that console_bridge's own build generates. The library is linked in and
// exports no symbols.
#pragma once

#define CONSOLE_BRIDGE_DLLAPI
#define CONSOLE_BRIDGE_DEPRECATED
