// Runs a persistent kernel on the host. The compiler of this build compiles its text, and its
// threads are fibers that take turns in a random order (host_persistent.h).
#pragma once

#include <dlfcn.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include "persistent_source.h"

namespace novaphy::gpu {

// The device code of a vendor for the host: barriers are barriers of fibers, the rest is generic.
constexpr const char* kHostVendor = R"(
#define VENDOR_WARP 32
#define VENDOR_HAS_BLOCK_BARRIERS
static void vendor_block_barrier() { sync_block(); }
template <int>
static void vendor_hand_over() { hand_over_block(); }
template <int>
static void vendor_take_over() { take_over_block(); }
static void vendor_cluster_arrive(bool) { arrive_all(); }
static void vendor_cluster_wait() { wait_all(); }
static void vendor_prefetch_bytes(unsigned long long, unsigned) {}
)";

// Replaces a text of the device code by one for fibers.
inline void replace(std::string& text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  ASSERT_NE(at, std::string::npos) << from;
  text.replace(at, from.size(), to);
}
inline void replace_body(std::string& text, const std::string& function, const std::string& body) {
  const size_t at = text.find(function);
  ASSERT_NE(at, std::string::npos) << function;
  const size_t begin = text.find("{\n", at), end = text.find("\n}\n", at);
  text.replace(begin, end + 2 - begin, "{ " + body + " }");
}
// Replaces the exchange between blocks.
inline void halo_for_host(std::string& text) {
  for (const std::string name : {"uint64_t g_came[2]", "uint32_t g_halo_bytes",
                                 "uint32_t g_sends[PERSISTENT_ROUNDS * kSenders]"}) {
    const size_t type = name.find(' ') + 1, size = std::min(name.find('['), name.size());
    const std::string variable = name.substr(type, size - type);
    replace(text, "__shared__ " + name + ";",
            "static " + name.substr(0, size) + "_of[64]" + name.substr(size) + ";\n#define " +
                variable + " " + variable + "_of[blockIdx.x]\n");
  }
  replace_body(text, "LANE_FN uint32_t in_block(", "return address | block << 20;");
  // Rows by their number, and barriers as odd or even.
  replace_body(text, "LANE_FN uint32_t in_shared(",
               "return p >= g_came && p < g_came + 2 ? (const uint64_t*)p - g_came"
               " : (const four_words*)p - g_items;");
  replace_body(text, "LANE_FN void begin_barrier(", "");
  replace_body(text, "LANE_FN void expect_rows(", "expect_bytes(turn, g_halo_bytes);");
  replace_body(text, "LANE_FN void wait_halo(", "wait_turn(turn);");
  replace_body(text, "LANE_FN void send_row(",
               "if (send.on == 0) return;"
               "four_words* const there = g_items_of[send.to >> 20] + (send.to & 0xfffff) + base;"
               "send_later(send.to >> 20, send.came, sizeof(row), [=] { *there = row; });");
  replace_body(text, "LANE_FN int32_t of_lane(", "return show(word, lane);");
}
inline std::string for_host(std::string text) {
  replace(text, cuda_text(), kHostVendor);
  if (text.find("#define PERSISTENT_LAYOUTS 0\n") == std::string::npos) {
    replace(text, "extern __shared__ four_words g_items[];",
            "static four_words g_items_of[64][1 << 15];\n#define g_items g_items_of[blockIdx.x]");
    replace(text, "__shared__ uint32_t g_rows[PERSISTENT_LAYOUTS * PERSISTENT_THREADS];",
            "static uint32_t g_rows_of[64][PERSISTENT_LAYOUTS * PERSISTENT_THREADS];\n"
            "#define g_rows g_rows_of[blockIdx.x]");
  }
  if (text.find("#define PERSISTENT_HALO 0\n") == std::string::npos) halo_for_host(text);
  const size_t begin = text.find("LANE_FN void phase_wait(uint32_t* counter, uint32_t count) {");
  const size_t end = text.find("#endif", begin);
  text.replace(begin, end - begin,
               "LANE_FN void phase_wait(uint32_t*, uint32_t) { arrive_all(); wait_all(); }\n"
               "LANE_FN void last_barrier(uint32_t*) {}\n");
  replace(text, "__shared__ int32_t g_kept[PERSISTENT_KEPT * PERSISTENT_THREADS];",
          "static int32_t g_kept_of[64][PERSISTENT_KEPT * PERSISTENT_THREADS];\n"
          "#define g_kept g_kept_of[blockIdx.x]");
  replace(text, "__shared__ uint64_t records[3][PERSISTENT_WORDS];",
          "static uint64_t records_of[64][3][PERSISTENT_WORDS];\n"
          "  uint64_t(&records)[3][PERSISTENT_WORDS] = records_of[blockIdx.x];");
  return "#include \"host_persistent.h\"\n" + text + "#include \"host_persistent_end.h\"\n";
}

class HostPersistent {
 public:
  // The table's addresses are the host's.
  HostPersistent(PersistentTable& table, const PersistentShape& shape)
      : table_(table), shape_(shape), early_halves_(table.early_bytes + kAlignment) {
    folder_ =
        std::filesystem::temp_directory_path() / ("novaphy_persistent_" + std::to_string(getpid()));
    std::filesystem::create_directories(folder_);
    for (const uint64_t word : table.relative)
      table.words[word] += reinterpret_cast<uint64_t>(table.words.data());
    const uint64_t memory = reinterpret_cast<uint64_t>(early_halves_.data()) + kAlignment - 1;
    for (const uint64_t word : table.early) table.words[word] += memory & ~(kAlignment - 1);
  }
  ~HostPersistent() {
    if (library_ != nullptr) dlclose(library_);
    std::filesystem::remove_all(folder_);
  }
  HostPersistent(const HostPersistent&) = delete;
  HostPersistent& operator=(const HostPersistent&) = delete;

  bool compiles() const { return library_ != nullptr; }
  // Returns false if the text does not compile, or if a read failed.
  bool run(unsigned seed) {
    using Run =
        void (*)(const uint64_t*, uint64_t*, void*, uint32_t*, unsigned, unsigned, unsigned);
    const auto run = reinterpret_cast<Run>(compiled());
    if (run == nullptr) return false;
    struct Record {  // the layout of device_error, with the zeros after it
      int64_t index = std::numeric_limits<int64_t>::max();
      std::array<int64_t, 63> rest{};
    } record;
    uint32_t flag = 0;
    const uint64_t start[] = {table_.first_words, table_.tasks, table_.rows,
                              table_.halo_turns,  table_.jobs,  table_.job_count};
    run(start, table_.words.data(), &record, &flag, shape_.blocks, shape_.threads, seed);
    return flag == 0;
  }

 private:
  static constexpr uint64_t kAlignment = 16;

  void* compiled() {
    // A unique name, because the loader may keep a closed library and return it again.
    static int number = 0;
    const std::string name = "persistent" + std::to_string(number++);
    const std::string from = folder_ / (name + ".cpp"), to = folder_ / (name + ".so");
    std::ofstream(from) << for_host(persistent_source(table_, shape_));
    const std::string command =
        HOST_COMPILER
        " -std=c++20 -O1 -w -ffp-contract=off -fno-strict-aliasing -shared -fPIC "
        "-I\"" HOST_PERSISTENT_FOLDER "\" -o \"" +
        to + "\" \"" + from + "\"";
    if (std::system(command.c_str()) != 0) return nullptr;
    library_ = dlopen(to.c_str(), RTLD_NOW | RTLD_LOCAL);
    return library_ == nullptr ? nullptr : dlsym(library_, "run_persistent");
  }

  PersistentTable& table_;
  const PersistentShape shape_;
  std::vector<char> early_halves_;
  std::filesystem::path folder_;
  void* library_ = nullptr;
};

}  // namespace novaphy::gpu
