// Internal to core: the number of CPUs that this process may use.
#pragma once

#include <filesystem>

namespace novaphy {

int affinity_cpus();  // CPUs in the affinity mask, at least 1

// Returns the CPU quota of this process's cgroup, rounded up; 0 means no quota. Supports cgroup v1
// and v2, and takes the smallest quota on the path up to the root. Tests pass another `root` than
// "/".
int cgroup_cpu_limit(const std::filesystem::path& root);

}  // namespace novaphy
