#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/core/stream.h"
#include "support/probe.h"

namespace novaphy {
namespace {

using testing::Outcome;
using testing::probe;

std::string plugin_folder(const std::string& name) {
  return std::string(NOVAPHY_PLUGIN_DIR) + "/" + name;
}
std::string plugin_file(const std::string& name) {
  return plugin_folder(name) + "/libnovaphy_backend_" + name + ".so";
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// A refused plugin keeps its reason, and the process still computes on the CPU.
void expect_refused(const std::string& plugin, const std::string& reason) {
  const Outcome listed = probe("NOVAPHY_BACKEND_PATH=" + plugin_folder(plugin), "backends");
  EXPECT_EQ(listed.code, 0);
  EXPECT_TRUE(contains(listed.output, plugin + "|" + plugin_file(plugin) + "|refused|idle|0|"))
      << listed.output;
  EXPECT_TRUE(contains(listed.output, reason)) << listed.output;
  EXPECT_TRUE(contains(listed.output, "|loaded|active|1|")) << listed.output;
  const Outcome loaded = probe("", "load " + plugin_file(plugin));
  EXPECT_EQ(loaded.code, 1);
  EXPECT_TRUE(contains(loaded.output, "error: load_backend: " + plugin_file(plugin) + ": "))
      << loaded.output;
  EXPECT_TRUE(contains(loaded.output, reason)) << loaded.output;
}

TEST(BackendRegistry, RefusesALibraryWithoutTheSymbol) {
  expect_refused("no_symbol", "exports no symbol novaphy_backend_query");
}
TEST(BackendRegistry, RefusesAnotherMajorVersion) {
  expect_refused("wrong_major",
                 "its ABI major version is " + std::to_string(NOVAPHY_ABI_MAJOR + 1));
}
TEST(BackendRegistry, RefusesATableThatEndsBeforeTheMandatoryFunctions) {
  expect_refused("short_table", "bytes, expected at least");
}
TEST(BackendRegistry, NamesTheFunctionThatIsMissing) {
  expect_refused("missing_function", "its function table lacks memory_fill");
}
TEST(BackendRegistry, RefusesHalfACaptureGroup) {
  expect_refused("half_capture", "all four functions or none");
}
TEST(BackendRegistry, PassesOnTheReasonOfAQueryThatReturnsNull) {
  expect_refused("null_with_reason", "too few vector units");
}
TEST(BackendRegistry, RefusesAnUnknownDeviceType) {
  expect_refused("unknown_type", "device type 77 is unknown");
}

class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "novaphy_backend_XXXXXX").string();
    path_ = mkdtemp(name.data());
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

TEST(BackendRegistry, RefusesAFileThatIsNoLibraryAndIgnoresOtherNames) {
  const TemporaryFolder folder;
  std::ofstream(folder.path() / "libnovaphy_backend_text.so") << "hello";
  std::ofstream(folder.path() / "libother.so") << "hello";
  const Outcome result = probe("NOVAPHY_BACKEND_PATH=" + folder.path().string(), "backends");
  EXPECT_EQ(result.code, 0);
  EXPECT_TRUE(contains(result.output, "text|" + folder.path().string() +
                                          "/libnovaphy_backend_text.so|refused|idle|0|"))
      << result.output;
  EXPECT_FALSE(contains(result.output, "libother")) << result.output;
}

TEST(BackendRegistry, RefusesATruncatedFileWithBothLengths) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "libnovaphy_backend_cut.so";
  const auto whole = std::filesystem::file_size(plugin_file("second_cpu"));
  for (const auto bytes : {whole / 50, whole / 5, whole / 2, whole * 9 / 10, whole - 1}) {
    std::filesystem::copy_file(plugin_file("second_cpu"), file,
                               std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(file, bytes);
    const Outcome result = probe("NOVAPHY_BACKEND_PATH=" + folder.path().string(), "backends");
    EXPECT_EQ(result.code, 0) << bytes << " of " << whole;
    EXPECT_TRUE(contains(result.output,
                         "cut|" + file.string() + "|refused|idle|0|truncated: the file has " +
                             std::to_string(bytes) + " bytes, its headers describe "))
        << bytes << " of " << whole << ": " << result.output;
  }
}

TEST(BackendRegistry, RefusesWhatIsNoRegularFileWithoutWaitingForIt) {
  const TemporaryFolder folder;
  const auto fifo = folder.path() / "libnovaphy_backend_fifo.so";
  ASSERT_EQ(mkfifo(fifo.c_str(), 0600), 0);
  std::filesystem::create_directory(folder.path() / "libnovaphy_backend_folder.so");
  std::filesystem::create_symlink("/nowhere", folder.path() / "libnovaphy_backend_dangling.so");
  const Outcome result = probe("NOVAPHY_BACKEND_PATH=" + folder.path().string(), "backends");
  EXPECT_EQ(result.code, 0) << result.output;
  for (const char* name : {"fifo", "folder"})
    EXPECT_TRUE(contains(result.output, std::string("libnovaphy_backend_") + name +
                                            ".so|refused|idle|0|not a regular file"))
        << result.output;
  EXPECT_TRUE(contains(result.output, "dangling.so|refused|idle|0|No such file")) << result.output;
}

TEST(BackendRegistry, NeverLooksIntoTheCurrentDirectory) {
  const Outcome plain = probe("", "backends", plugin_folder("second_cpu"));
  EXPECT_FALSE(contains(plain.output, "second_cpu")) << plain.output;
  for (const char* relative : {".", "plugins", "../second_cpu"}) {
    const Outcome result = probe(std::string("NOVAPHY_BACKEND_PATH=") + relative, "backends",
                                 plugin_folder("second_cpu"));
    EXPECT_FALSE(contains(result.output, "libnovaphy_backend_second_cpu")) << result.output;
    EXPECT_TRUE(contains(result.output, "expected an absolute path")) << result.output;
  }
}

TEST(BackendRegistry, SkipsDisabledNamesAndSaysSo) {
  const Outcome result = probe(
      "NOVAPHY_DISABLE_BACKENDS=cpu,second_cpu NOVAPHY_BACKEND_PATH=" + plugin_folder("second_cpu"),
      "backends");
  EXPECT_TRUE(contains(result.output, "second_cpu|" + plugin_file("second_cpu") +
                                          "|refused|idle|0|disabled by NOVAPHY_DISABLE_BACKENDS"))
      << result.output;
  EXPECT_TRUE(contains(result.output, "cpu||loaded|active|1|"))
      << "the linked-in one stays: " << result.output;
}

TEST(BackendRegistry, PrefersAPluginToTheLinkedInBackend) {
  const Outcome result = probe("NOVAPHY_BACKEND_PATH=" + plugin_folder("second_cpu"), "backends");
  EXPECT_TRUE(contains(result.output, "cpu|" + plugin_file("second_cpu") + "|loaded|active|1|"))
      << result.output;
  EXPECT_TRUE(contains(result.output, "cpu||loaded|idle|1|")) << result.output;
}

TEST(BackendRegistry, LoadsAPluginByPathAndUsesIt) {
  const Outcome result = probe("", "load " + plugin_file("second_cpu"));
  EXPECT_EQ(result.code, 0) << result.output;
  EXPECT_TRUE(contains(result.output, "cpu 1.2.3 active\n2\n")) << result.output;
}

TEST(BackendRegistry, ADeviceThatIsNotThereNamesWhatWasTried) {
  // Disabled: this machine may have a GPU.
  const std::string without = "NOVAPHY_DISABLE_BACKENDS=cuda";
  const Outcome nothing = probe(without, "open cuda");
  EXPECT_EQ(nothing.code, 1);
  EXPECT_TRUE(contains(nothing.output, "error: cuda backend not available: ")) << nothing.output;
  const Outcome no_device =
      probe(without + " NOVAPHY_BACKEND_PATH=" + plugin_folder("no_device"), "open cuda:0");
  EXPECT_TRUE(contains(no_device.output, "cuda backend not available: " + plugin_file("no_device") +
                                             ": no driver found"))
      << no_device.output;
  const Outcome cpu = probe("", "open cpu");
  EXPECT_EQ(cpu.output, "opened\n");
}

TEST(BackendRegistry, ReportsABadNumberOfThreadsOrInstructionSetWhenTheDeviceOpens) {
  const Outcome threads = probe("NOVAPHY_NUM_THREADS=many", "open cpu");
  EXPECT_EQ(threads.code, 1);
  EXPECT_TRUE(contains(threads.output,
                       "NOVAPHY_NUM_THREADS: expected an integer from 1 to 1024, got \"many\""))
      << threads.output;
  const Outcome isa = probe("NOVAPHY_CPU_ISA=mmx", "open cpu");
  EXPECT_EQ(isa.code, 1);
  EXPECT_TRUE(contains(isa.output, "NOVAPHY_CPU_ISA: expected baseline, avx2 or avx512, got 'mmx'"))
      << isa.output;
}

// A copy of the core library in a separate folder, without the plugin beside it.
class CoreAlone {
 public:
  CoreAlone() {
    namespace fs = std::filesystem;
    for (const auto& entry : fs::directory_iterator(NOVAPHY_LIBRARY_DIR))
      if (contains(entry.path().filename().string(), "libnovaphy_core.so") && !entry.is_symlink())
        fs::copy_file(entry.path(), folder_.path() / NOVAPHY_CORE_SONAME);
  }
  void add_plugin(const std::string& file) const {
    std::filesystem::create_directory(folder_.path() / "novaphy_backends");
    std::filesystem::copy_file(file,
                               folder_.path() / "novaphy_backends" / "libnovaphy_backend_cpu.so");
  }
  Outcome open(const std::string& environment) const {
    return probe("LD_LIBRARY_PATH=" + folder_.path().string() + " " + environment, "open cpu");
  }

 private:
  TemporaryFolder folder_;
};
constexpr const char* kInterpreted = "novaphy: kernels are interpreted";
#ifdef NOVAPHY_WITH_NATIVE_KERNELS
constexpr bool kSaysSo = true;
#else
constexpr bool kSaysSo = false;  // none were to be expected
#endif

TEST(BackendRegistry, WithoutTheCpuPluginItComputesAndSaysThatKernelsAreInterpreted) {
  const CoreAlone core;
  const Outcome result = core.open("");
  EXPECT_EQ(result.code, 0) << result.output;
  const size_t first = result.output.find(kInterpreted);
  EXPECT_EQ(first != std::string::npos, kSaysSo) << result.output;
  if (kSaysSo) {
    EXPECT_EQ(result.output.find(kInterpreted, first + 1), std::string::npos) << "once";
    EXPECT_TRUE(contains(result.output, "no file libnovaphy_backend_cpu.so in")) << result.output;
  }
  EXPECT_FALSE(contains(core.open("NOVAPHY_QUIET=1").output, kInterpreted));
  EXPECT_FALSE(contains(probe("", "open cpu").output, kInterpreted)) << "with the plugin";
}
TEST(BackendRegistry, RefusesTheCpuPluginOfAnotherVersion) {
  const CoreAlone core;
  core.add_plugin(plugin_file("second_cpu"));
  const Outcome result = core.open("");
  EXPECT_EQ(result.code, 0) << result.output;
  EXPECT_EQ(contains(result.output, "it is of version 1.2.3, this library of"), kSaysSo)
      << result.output;
  EXPECT_FALSE(contains(core.open("NOVAPHY_DISABLE_BACKENDS=cpu").output, kInterpreted));
}

TEST(BackendRegistry, OpensADeviceOnce) {
  const DeviceContext& first = device_context(Device::cpu());
  EXPECT_EQ(&first, &device_context(Device::cpu()));
  EXPECT_TRUE(first.host_accessible);
  EXPECT_NE(first.stream, nullptr);
}

TEST(Check, MapsTheStatusAndNamesTheOperation) {
  novaphy_error error = make_error();
  EXPECT_NO_THROW(check(NOVAPHY_OK, error, "x"));
  std::snprintf(error.message, sizeof(error.message), "row 7");
  try {
    check(NOVAPHY_INDEX_OUT_OF_RANGE, error, "launch");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::Index);
    EXPECT_STREQ(e.what(), "launch: row 7");
  }
  try {
    check(NOVAPHY_OUT_OF_MEMORY, make_error(), "alloc");
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::Runtime);
  }
}

TEST(StreamAndEvent, MeasureAndWait) {
  Stream stream(Device::cpu()), second(Device::cpu());
  Event start(Device::cpu()), stop(Device::cpu());
  EXPECT_THROW(Event::elapsed(start, stop), Error);
  stream.record(start);
  stream.record(stop);
  second.wait(stop);
  second.synchronize();
  stop.synchronize();
  EXPECT_GE(Event::elapsed(start, stop), 0.0);
  Stream moved = std::move(second);
  EXPECT_NE(moved.native(), nullptr);
  EXPECT_EQ(moved.device(), Device::cpu());
}

}  // namespace
}  // namespace novaphy
