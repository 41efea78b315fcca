// Symbol visibility: a symbol is hidden unless its library's macro exports the symbol.
#pragma once

#define NOVAPHY_EXPORT __attribute__((visibility("default")))
#define NOVAPHY_CORE_API NOVAPHY_EXPORT
