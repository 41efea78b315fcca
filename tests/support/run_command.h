// Runs a process, for tests of its output and exit status.
#pragma once

#include <sys/wait.h>

#include <cstdio>
#include <string>

namespace novaphy::testing {

struct Outcome {
  int code = -1;       // -1: it was not run, or did not exit by itself
  std::string output;  // both streams
};

// `line` as in a shell.
inline Outcome run_command(const std::string& line) {
  Outcome outcome;
  std::FILE* pipe = popen((line + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return outcome;
  char text[1024];
  while (std::fgets(text, sizeof(text), pipe) != nullptr) outcome.output += text;
  const int status = pclose(pipe);
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
}

}  // namespace novaphy::testing
