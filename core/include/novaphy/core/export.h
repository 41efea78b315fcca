// Symbol visibility: everything is hidden unless it carries its library's macro.
#pragma once

#define NOVAPHY_EXPORT __attribute__((visibility("default")))
#define NOVAPHY_CORE_API NOVAPHY_EXPORT
