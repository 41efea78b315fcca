// Internal to core: how many CPUs this process may use.
#pragma once

#include <filesystem>

namespace novaphy {

int affinity_cpus();  // CPUs in the affinity mask, at least 1

// The CPU quota of the cgroup of this process, rounded up, or 0 when there is none. Understands
// cgroup v1 and v2 and takes the smallest quota on the way up to the root. `root` is "/" outside of
// tests.
int cgroup_cpu_limit(const std::filesystem::path& root);

}  // namespace novaphy
