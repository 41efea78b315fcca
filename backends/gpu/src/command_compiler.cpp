// Runs a compiler that is a separate program.
#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "compiler.h"

extern char** environ;

namespace novaphy::gpu {
namespace {

namespace fs = std::filesystem;

// A temporary folder, which the destructor removes.
struct Folder {
  std::string path = (fs::temp_directory_path() / "novaphy_compile_XXXXXX").string();
  const bool made = mkdtemp(path.data()) != nullptr;
  Folder() = default;
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    if (made) fs::remove_all(path, ignored);
  }
};

std::vector<char> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Runs the command and returns its exit code. The output of the command goes to the file `log`.
int run(std::string command, std::string code, std::string source, const std::string& log) {
  char* const words[] = {command.data(), code.data(), source.data(), nullptr};
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_addopen(&files, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
  posix_spawn_file_actions_adddup2(&files, 1, 2);
  pid_t process = 0;
  const int failed = posix_spawnp(&process, words[0], &files, nullptr, words, environ);
  posix_spawn_file_actions_destroy(&files);
  int status = 0;
  if (failed != 0 || waitpid(process, &status, 0) != process) return 127;
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128;
}

}  // namespace

CompiledCode compile_by_command(const std::string& command, const std::string& source) {
  CompiledCode code;
  const Folder folder;
  const std::string from = folder.path + "/kernel.cu", to = folder.path + "/kernel.code",
                    log = folder.path + "/log";
  if (!folder.made || !(std::ofstream(from) << source).flush()) {
    code.problem = "cannot write " + from;
    return code;
  }
  if (const int status = run(command, to, from, log); status != 0) {
    const std::vector<char> said = read_file(log);
    code.problem = command + " ended with " + std::to_string(status) + "\n" +
                   std::string(said.begin(), said.end());
    return code;
  }
  code.bytes = read_file(to);
  if (code.bytes.empty()) code.problem = command + " wrote no code";
  return code;
}

}  // namespace novaphy::gpu
