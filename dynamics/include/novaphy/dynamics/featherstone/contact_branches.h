// Includes ContactBranches from articulation/ for solvers and their users.
#pragma once

#include "novaphy/dynamics/articulation/contact_branches.h"
