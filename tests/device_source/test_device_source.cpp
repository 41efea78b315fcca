// The build tool that converts kernel headers of the host to source text for devices.
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <stdexcept>

#include "device_source.h"

namespace novaphy::device_source {
namespace {

namespace fs = std::filesystem;

// Writes headers to a temporary folder, which the end of the test removes.
class KernelText : public ::testing::Test {
 protected:
  KernelText()
      : folder_(fs::temp_directory_path() /
                ("novaphy_device_text_" + std::to_string(::getpid()) + "_" +
                 ::testing::UnitTest::GetInstance()->current_test_info()->name())) {
    fs::remove_all(folder_);
  }
  ~KernelText() override { fs::remove_all(folder_); }

  fs::path write(const std::string& name, const std::string& text) const {
    fs::create_directories((folder_ / name).parent_path());
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return folder_ / name;
  }

  Source read(const fs::path& header) const {
    return read_source(header, {folder_ / "first", folder_ / "second"});
  }

  fs::path folder_;
};

TEST_F(KernelText, HeadersTakeThePlaceOfTheirIncludesEachOnceBehindThoseThatTheyInclude) {
  write("first/novaphy/a.h", "#pragma once\nint a;\n");
  write("first/novaphy/b.h", "#pragma once\n#include <cmath>\n#include \"novaphy/a.h\"\nint b;\n");
  const fs::path header =
      write("k.h", "#include \"novaphy/b.h\"  // both\n#include \"novaphy/a.h\"\n\nint kernel;\n");
  const Source source = read(header);
  EXPECT_EQ(source.text, "int a;\nint b;\n\nint kernel;\n");
  EXPECT_EQ(source.files, (std::vector<fs::path>{header, folder_ / "first/novaphy/b.h",
                                                 folder_ / "first/novaphy/a.h"}));
}

TEST_F(KernelText, TheFirstFolderThatHasAHeaderHidesTheOthers) {
  write("first/novaphy/twin.h", "int device;\n");
  write("second/novaphy/twin.h", "int host;\n");
  write("second/novaphy/only.h", "int only;\n");
  const fs::path header =
      write("k.h", "#include \"novaphy/twin.h\"\n#include \"novaphy/only.h\"\n");
  EXPECT_EQ(read(header).text, "int device;\nint only;\n");
}

TEST_F(KernelText, AnIncludeThatNoFolderHasIsNamedWithItsLine) {
  for (const char* name : {"novaphy/none.h", "rows.h"}) {
    const fs::path header = write("k.h", std::string("int x;\n#include \"") + name + "\"\n");
    try {
      read(header);
      FAIL() << name;
    } catch (const std::runtime_error& error) {
      const std::string message = error.what();
      EXPECT_NE(message.find("k.h:2: "), std::string::npos) << message;
      EXPECT_NE(message.find(name), std::string::npos) << message;
    }
  }
  EXPECT_THROW(read(folder_ / "absent.h"), std::runtime_error);
}

TEST(DeviceCode, HasNoIncludeAndNoPragma) {
  EXPECT_EQ(device_code("#pragma once\n#include <array>\n#define A 1\nint x;\n"),
            "#define A 1\nint x;\n");
}

TEST(DeviceCode, HasTheComparisonOfVec3AndNoDefaultedOne) {
  EXPECT_EQ(device_code("struct Vec3 {\n"
                        "  bool operator==(const Vec3&) const = default;\n"
                        "  float x, y, z;\n};\n"),
            "struct Vec3 {\n"
            "  bool operator==(const Vec3& o) const { return x == o.x && y == o.y && z == o.z; }\n"
            "  float x, y, z;\n};\n");
  EXPECT_EQ(device_code("struct Quat {\n"
                        "  bool operator==(const Quat&) const = default;\n"
                        "  float x;\n};\n"),
            "struct Quat {\n  float x;\n};\n");
  // A comparison that is written out stays.
  const char* written = "struct A {\n  bool operator==(const A& o) const { return true; }\n};\n";
  EXPECT_EQ(device_code(written), written);
}

TEST(DeviceCode, CallsFormulasWithAnyTypeInPlaceOfAConcept) {
  EXPECT_EQ(device_code("int x;\ntemplate <class T>\nconcept FormulaScalar = requires(T a) {\n"
                        "  a + a;\n};\ntemplate <FormulaScalar T>\nT twice(T a);\n"),
            "int x;\ntemplate <class T>\nT twice(T a);\n");
}

TEST(KernelLines, HaveTheNameTheWordsAndTheKindOfEachDeclaration) {
  EXPECT_EQ(kernel_lines("\nNOVAPHY_ROW_KERNEL(move_rows, Move) {\n}\n"
                         "NOVAPHY_BLOCK_KERNEL(sum_2, 12, Sum) {\n}\n"
                         "NOVAPHY_SHARED_BLOCK_KERNEL(solve, Solve) {\n}\n"
                         "NOVAPHY_ROW_KERNEL(lower, argument)\n"
                         "#define NOVAPHY_ROW_KERNEL(name, A)\n"),
            "// kernel move_rows 0 NOVAPHY_ROW\n// kernel sum_2 12 NOVAPHY_BLOCK\n"
            "// kernel solve 0 NOVAPHY_BLOCK\n");
}

TEST(CodeOfTheBuild, IsIncludedAsCodeAndAsText) {
  const std::string text = device_code("int a;\n#include \"slot_adjoints.inc\"\n\nint b;\n");
  EXPECT_EQ(with_includes(text), "int a;\n#include \"slot_adjoints.inc\"\n\nint b;\n");
  EXPECT_EQ(as_literals(text),
            "R\"==(int a;\n)==\"\n#include \"slot_adjoints_source.inc\"\nR\"==(\n)==\"\n"
            "    R\"==(\nint b;\n)==\"");
}

TEST(Literals, JoinToTheText) {
  // Joins the texts between `R"==(` and `)=="`, as a compiler does.
  const std::string text = "a\n\nb\n\n\nc \\ \" )\" \n";
  std::string literals = as_literals(text);
  std::string joined;
  for (size_t at = 0; (at = literals.find("R\"==(", at)) != std::string::npos;) {
    const size_t end = literals.find(")==\"", at);
    joined += literals.substr(at + 5, end - at - 5);
    at = end;
  }
  EXPECT_EQ(joined, text);
}

}  // namespace
}  // namespace novaphy::device_source
