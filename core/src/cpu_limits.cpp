#include "cpu_limits.h"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>
#include <vector>

namespace novaphy {
namespace fs = std::filesystem;
namespace {

// Returns quota / period rounded up. 0: a value is missing or means "no limit".
int to_cpus(double quota, double period) {
  if (!(quota > 0.0) || !(period > 0.0)) return 0;
  return static_cast<int>(std::clamp(std::ceil(quota / period), 1.0, 1.0e6));
}

std::string text_of(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Removes the next word of a text and returns it as a number, or 0 if the word is not a number
// ("max").
double parse_number(std::string_view& text) {
  text.remove_prefix(std::min(text.find_first_not_of(" \t\n"), text.size()));
  double value = 0.0;
  const char* end = std::from_chars(text.data(), text.data() + text.size(), value).ptr;
  text.remove_prefix(static_cast<size_t>(end - text.data()));
  return value;
}

int read_v2(const fs::path& folder) {
  const std::string text = text_of(folder / "cpu.max");
  std::string_view rest = text;
  const double quota = parse_number(rest);
  return to_cpus(quota, parse_number(rest));
}

int read_v1(const fs::path& folder) {
  const std::string quota = text_of(folder / "cpu.cfs_quota_us");
  const std::string period = text_of(folder / "cpu.cfs_period_us");
  std::string_view first = quota, second = period;
  return to_cpus(parse_number(first), parse_number(second));
}

// Returns the smallest limit of `group` and of its parent groups. In a container the path of the
// group may not exist under the mount. The root of the mount is then the group of this process.
int smallest(const fs::path& mount, fs::path group, int (*read)(const fs::path&)) {
  int limit = 0;
  group = group.relative_path();
  while (true) {
    const int here = read(mount / group);
    if (here > 0 && (limit == 0 || here < limit)) limit = here;
    if (group.empty()) return limit;
    group = group.parent_path();
  }
}

bool names_cpu(const std::string& controllers) {
  return ("," + controllers + ",").find(",cpu,") != std::string::npos;
}

}  // namespace

int affinity_cpus() {
  // On a big machine the mask may exceed cpu_set_t. The loop enlarges the set until the kernel
  // accepts its size.
  for (int cpus = 1024; cpus <= (1 << 20); cpus *= 2) {
    cpu_set_t* set = CPU_ALLOC(static_cast<size_t>(cpus));
    if (set == nullptr) break;
    const size_t bytes = CPU_ALLOC_SIZE(static_cast<size_t>(cpus));
    CPU_ZERO_S(bytes, set);
    const int count = sched_getaffinity(0, bytes, set) == 0 ? CPU_COUNT_S(bytes, set) : 0;
    CPU_FREE(set);
    if (count > 0) return count;
  }
  return static_cast<int>(std::max(1L, sysconf(_SC_NPROCESSORS_ONLN)));
}

int cgroup_cpu_limit(const fs::path& root) {
  const fs::path mount = root / "sys/fs/cgroup";
  const std::string text = text_of(root / "proc/self/cgroup");
  int limit = 0;
  for (size_t begin = 0, end; begin < text.size(); begin = end + 1) {
    end = std::min(text.find('\n', begin), text.size());
    const std::string line = text.substr(begin, end - begin);
    // A line is "0::/path" for v2, and "4:cpu,cpuacct:/path" for v1.
    const size_t first = line.find(':');
    const size_t second = first == std::string::npos ? first : line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    const fs::path group = line.substr(second + 1);
    std::vector<int> found;
    if (controllers.empty()) {
      found.push_back(smallest(mount, group, read_v2));
    } else if (names_cpu(controllers)) {
      found.push_back(smallest(mount / controllers, group, read_v1));
      if (controllers != "cpu") found.push_back(smallest(mount / "cpu", group, read_v1));
    }
    for (const int here : found) {
      if (here > 0 && (limit == 0 || here < limit)) limit = here;
    }
  }
  return limit;
}

}  // namespace novaphy
