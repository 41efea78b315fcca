// The cache of device code on disk.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "code_cache.h"

namespace novaphy::gpu {
namespace {

namespace fs = std::filesystem;

class CodeCacheTest : public ::testing::Test {
 protected:
  CodeCacheTest()
      : folder(fs::path(::testing::TempDir()) / ("cache" + std::to_string(::getpid()))) {
    fs::remove_all(folder);
  }
  ~CodeCacheTest() override { fs::remove_all(folder); }

  std::vector<fs::path> files() const {
    std::vector<fs::path> list;
    for (const auto& entry : fs::directory_iterator(folder)) list.push_back(entry.path());
    return list;
  }
  static std::vector<char> code(size_t bytes, char first) {
    std::vector<char> data(bytes);
    for (size_t k = 0; k < bytes; ++k)
      data[k] = static_cast<char>(first + static_cast<char>(k % 7));
    return data;
  }

  fs::path folder;
  std::vector<char> found;
};

TEST_F(CodeCacheTest, GivesBackWhatWasStoredAlsoToAnotherCache) {
  CodeCache cache(folder, 1 << 20);
  const CodeKey key = code_key("a kernel");
  EXPECT_FALSE(cache.find(key, found));
  cache.store(key, code(1000, 'a'));
  EXPECT_TRUE(CodeCache(folder, 1 << 20).find(key, found));
  EXPECT_EQ(found, code(1000, 'a'));
  EXPECT_FALSE(cache.find(code_key("another kernel"), found));
  EXPECT_EQ(files().size(), 1u);  // no drafts are left
}

TEST_F(CodeCacheTest, ADamagedFileIsRemovedAndMadeAnew) {
  CodeCache cache(folder, 1 << 20);
  const CodeKey key = code_key("a kernel");
  const auto damage = [&](auto&& how) {
    cache.store(key, code(1000, 'a'));
    how(files().at(0));
    EXPECT_FALSE(cache.find(key, found));
    EXPECT_TRUE(found.empty());
    EXPECT_TRUE(files().empty());
  };
  damage([](const fs::path& file) { fs::resize_file(file, 500); });
  damage([](const fs::path& file) { fs::resize_file(file, 3); });
  damage([](const fs::path& file) {
    std::fstream stream(file, std::ios::in | std::ios::out | std::ios::binary);
    stream.seekp(700);
    stream.put('!');
  });
  cache.store(key, code(10, 'b'));
  EXPECT_TRUE(cache.find(key, found));
  EXPECT_EQ(found, code(10, 'b'));
}

TEST_F(CodeCacheTest, AFileOfAnotherKeyUnderThisNameIsNotTaken) {
  CodeCache cache(folder, 1 << 20);
  cache.store(code_key("one"), code(100, 'a'));
  const fs::path one = files().at(0);
  cache.store(code_key("two"), code(100, 'b'));
  for (const fs::path& file : files())
    if (file != one) fs::copy_file(one, file, fs::copy_options::overwrite_existing);
  EXPECT_FALSE(cache.find(code_key("two"), found));
  EXPECT_TRUE(cache.find(code_key("one"), found));
}

TEST_F(CodeCacheTest, StaysBelowItsLimit) {
  CodeCache cache(folder, 100000);
  cache.store(code_key("too large"), code(200000, 'a'));
  EXPECT_FALSE(cache.find(code_key("too large"), found));
  for (int k = 0; k < 400; ++k) cache.store(code_key(std::to_string(k)), code(1000, 'a'));
  uint64_t bytes = 0;
  for (const fs::path& file : files()) bytes += fs::file_size(file);
  EXPECT_LE(bytes, 100000u + 64 * 1100u);  // the cache checks its size only now and then
  EXPECT_TRUE(cache.find(code_key("399"), found));
}

TEST_F(CodeCacheTest, ManyProcessesMayWriteTheSameEntries) {
  std::vector<pid_t> children;
  for (int child = 0; child < 4; ++child) {
    const pid_t pid = ::fork();
    ASSERT_GE(pid, 0);
    if (pid == 0) {
      CodeCache cache(folder, 1 << 20);
      bool good = true;
      std::vector<char> got;
      for (int k = 0; k < 100; ++k) {
        const CodeKey key = code_key(std::to_string(k % 5));
        const auto expected = code(5000, static_cast<char>('a' + k % 5));
        cache.store(key, expected);
        good = good && cache.find(key, got) && got == expected;
      }
      ::_exit(good ? 0 : 1);
    }
    children.push_back(pid);
  }
  for (const pid_t pid : children) {
    int status = 0;
    ASSERT_EQ(::waitpid(pid, &status, 0), pid);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  EXPECT_EQ(files().size(), 5u);
}

TEST_F(CodeCacheTest, AFolderThatCannotBeMadeIsNoError) {
  CodeCache cache("/proc/no/such/folder", 1 << 20);
  cache.store(code_key("a"), code(10, 'a'));
  EXPECT_FALSE(cache.find(code_key("a"), found));
}

TEST(CodeKeyTest, TellsContractionDevicesAndTextsApart) {
  const std::string text = "a kernel";
  const CodeKey strict = ahead_key(text, Dialect::Program);
  EXPECT_EQ(strict, ahead_key(text, Dialect::Program));
  EXPECT_FALSE(strict == ahead_key(text, Dialect::Contracted));
  EXPECT_FALSE(strict == ahead_key(text + " ", Dialect::Program));
  EXPECT_FALSE(ahead_key(text, Dialect::Source) == ahead_key(text, Dialect::ContractedSource));
  EXPECT_FALSE(disk_key(text, Dialect::Program, 80) == disk_key(text, Dialect::Program, 90));
}

}  // namespace
}  // namespace novaphy::gpu
