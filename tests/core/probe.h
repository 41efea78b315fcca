// Runs the probe process with an environment.
#pragma once

#include <sys/wait.h>

#include <cstdio>
#include <string>

namespace novaphy::testing {

struct ProbeResult {
  int code = -1;
  std::string output;
};

// `environment` as in a shell: "A=1 B=2"; `folder` becomes the current directory.
inline ProbeResult probe(const std::string& environment, const std::string& arguments,
                         const std::string& folder = "/") {
  const std::string clean =
      "-u NOVAPHY_BACKEND_PATH -u NOVAPHY_DISABLE_BACKENDS -u NOVAPHY_DEVICE -u "
      "NOVAPHY_NUM_THREADS";
  const std::string command = "cd " + folder + " && env " + clean + " " + environment +
                              " " NOVAPHY_PROBE " " + arguments + " 2>&1";
  ProbeResult result;
  std::FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return result;
  char line[1024];
  while (std::fgets(line, sizeof(line), pipe) != nullptr) result.output += line;
  const int status = pclose(pipe);
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return result;
}

}  // namespace novaphy::testing
