// Compiles device code ahead of time with NVRTC, which needs no GPU.
//
//   novaphy_device_compiler OUTPUT_FILE ARCHITECTURES [--programs FILE] [--cache ARCHITECTURE]
//
// OUTPUT_FILE gets the builtins, the interpreter and the engine's kernels, compiled for every
// architecture of the comma-separated list. The file also has them as assembler text for devices
// that are newer than the last architecture. With --programs, the serialized Programs in FILE
// replace the engine's kernels. With --cache, the compiled code goes into the cache on disk
// instead, as a run on a device of ARCHITECTURE would store it.
#include <algorithm>
#include <atomic>
#include <cstring>
#include <fstream>
#include <iostream>
#include <mutex>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "ahead.h"
#include "code_cache.h"
#include "compiler.h"
#include "device_source.h"
#include "novaphy/collision/device_modules.h"
#include "novaphy/dynamics/device_modules.h"
#ifdef NOVAPHY_VBD_MODULES
#include "novaphy/vbd/device_modules.h"
#endif
#include "programs.h"
#include "vendor.h"

namespace novaphy::gpu {

// The generator is not a plugin, so it contains no kernels that were compiled ahead of time.
AheadData ahead_data() { return {nullptr, 0}; }
const VendorInfo& vendor() {
  static constexpr VendorInfo kNone = {"none",
                                       0,
                                       "CUDA",
                                       "sm_",
                                       cuda_text,
                                       "NOVAPHY_CUDA_DRIVER",
                                       [] { return static_cast<const char*>(nullptr); },
                                       {nullptr, nullptr, nullptr, nullptr},
                                       load_driver,
                                       0,
                                       &kNvrtc,
                                       nullptr,
                                       false,
                                       0};
  return kNone;
}

}  // namespace novaphy::gpu

namespace {

namespace gpu = novaphy::gpu;

struct Job {
  std::string source, name;
  gpu::Dialect dialect = gpu::Dialect::Program;
  int arch = 0;
  bool as_text = false;
  gpu::CompiledCode code;
};

// Compiles in several threads at a time, which NVRTC allows.
void compile_all(std::vector<Job>& jobs) {
  std::atomic<size_t> next{0};
  const auto work = [&] {
    for (size_t k = next++; k < jobs.size(); k = next++) {
      Job& job = jobs[k];
      job.code = gpu::compile(job.source, job.arch, job.dialect, job.as_text);
    }
  };
  std::vector<std::thread> threads;
  for (unsigned k = 1; k < std::thread::hardware_concurrency(); ++k) threads.emplace_back(work);
  work();
  for (std::thread& thread : threads) thread.join();
  for (const Job& job : jobs)
    if (!job.code.problem.empty())
      throw std::runtime_error(job.name + ": " + job.code.problem + "\n" + job.source);
}

void write_file(const std::string& path, std::vector<Job>& jobs) {
  struct Item {
    gpu::AheadEntry entry;
    const Job* job;
  };
  std::vector<Item> items;
  for (const Job& job : jobs)
    items.push_back({{gpu::ahead_key(job.source, job.dialect), job.arch, job.as_text ? 1 : 0, 0,
                      job.code.bytes.size()},
                     &job});
  const auto order = [](const Item& x, const Item& y) {
    return std::tie(x.entry.key.a, x.entry.key.b, x.entry.is_text, x.entry.arch) <
           std::tie(y.entry.key.a, y.entry.key.b, y.entry.is_text, y.entry.arch);
  };
  std::sort(items.begin(), items.end(), order);
  const auto aligned = [](uint64_t at) { return (at + 63) / 64 * 64; };
  uint64_t at = aligned(sizeof(gpu::AheadHeader) + items.size() * sizeof(gpu::AheadEntry));
  for (Item& item : items) {
    item.entry.offset = at;
    at = aligned(at + item.entry.bytes);
  }
  std::string bytes(at, '\0');
  gpu::AheadHeader header{};
  std::memcpy(header.magic, gpu::kAheadMagic, sizeof(header.magic));
  header.count = items.size();
  std::memcpy(bytes.data(), &header, sizeof(header));
  size_t entry_at = sizeof(header);
  for (const Item& item : items) {
    std::memcpy(bytes.data() + entry_at, &item.entry, sizeof(item.entry));
    entry_at += sizeof(item.entry);
    std::memcpy(bytes.data() + item.entry.offset, item.job->code.bytes.data(), item.entry.bytes);
  }
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

int run(int argc, char** argv) {
  std::vector<std::string> words(argv + 1, argv + argc);
  std::string programs_file;
  int cache_arch = 0;
  for (size_t k = 0; k + 1 < words.size();) {
    if (words[k] == "--programs") {
      programs_file = words[k + 1];
    } else if (words[k] == "--cache") {
      cache_arch = std::stoi(words[k + 1]);
    } else {
      ++k;
      continue;
    }
    words.erase(words.begin() + static_cast<std::ptrdiff_t>(k),
                words.begin() + static_cast<std::ptrdiff_t>(k) + 2);
  }
  if (words.size() != (cache_arch != 0 ? 0u : 2u)) {
    std::cerr << "usage: " << argv[0]
              << " OUTPUT_FILE ARCHITECTURES [--programs FILE] | --cache ARCHITECTURE "
                 "[--programs FILE]\n";
    return 2;
  }
  if (!gpu::compiler(0).available()) throw std::runtime_error(gpu::compiler(0).problem);
  std::vector<int> archs;
  if (cache_arch != 0) {
    archs = {cache_arch};
  } else {
    std::stringstream list(words[1]);
    for (std::string arch; std::getline(list, arch, ',');) archs.push_back(std::stoi(arch));
    std::sort(archs.begin(), archs.end());
  }
  std::vector<Job> jobs;
  const auto add = [&](const std::string& source, const std::string& name, gpu::Dialect dialect) {
    for (const int arch : archs) jobs.push_back({source, name, dialect, arch, false, {}});
    if (cache_arch == 0) jobs.push_back({source, name, dialect, archs.back(), true, {}});
  };
  add(gpu::builtins_source(), "builtins", gpu::Dialect::Program);
  add(gpu::interpreter_source(), "interpreter", gpu::Dialect::Program);
  const auto programs = programs_file.empty() ? generator::engine_programs()
                                              : generator::read_programs(programs_file);
  for (const nova::ir::Program& p : programs)
    add(gpu::kernel_source(p), p.name,
        p.contract ? gpu::Dialect::Contracted : gpu::Dialect::Program);
  for (const std::string& text : novaphy::collision_device_modules())
    add(gpu::module_source(text), "collision", gpu::Dialect::Source);
  for (const std::string& text : novaphy::dynamics_device_modules())
    add(gpu::module_source(text), "dynamics", gpu::Dialect::Source);
#ifdef NOVAPHY_VBD_MODULES
  for (const std::string& text : novaphy::vbd_device_modules())
    add(gpu::module_source(text), "vbd", gpu::Dialect::Source);
#endif
  compile_all(jobs);
  if (cache_arch != 0) {
    for (const Job& job : jobs)
      gpu::CodeCache::get().store(gpu::disk_key(job.source, job.dialect, job.arch), job.code.bytes);
  } else {
    write_file(words[0], jobs);
  }
  std::cout << programs.size() << " Programs compiled by NVRTC " << gpu::compiler(0).major << "."
            << gpu::compiler(0).minor << " into " << jobs.size() << " pieces\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << argv[0] << ": " << error.what() << "\n";
    return 1;
  }
}
