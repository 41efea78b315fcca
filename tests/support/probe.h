// Runs the probe process with a given environment.
#pragma once

#include <string>

#include "support/run_command.h"

namespace novaphy::testing {

// Runs the probe and returns its exit code and output. `environment` has the variables as in a
// shell: "A=1 B=2". `folder` becomes the current directory.
inline Outcome probe(const std::string& environment, const std::string& arguments,
                     const std::string& folder = "/") {
  const std::string clean =
      "-u NOVAPHY_BACKEND_PATH -u NOVAPHY_DISABLE_BACKENDS -u NOVAPHY_DEVICE -u "
      "NOVAPHY_NUM_THREADS";
  return run_command("cd " + folder + " && env " + clean + " " + environment +
                     " " NOVAPHY_PROBE " " + arguments);
}

}  // namespace novaphy::testing
