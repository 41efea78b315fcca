// ContactBranches, where solvers and their users look for it.
#pragma once

#include "novaphy/dynamics/articulation/contact_branches.h"
